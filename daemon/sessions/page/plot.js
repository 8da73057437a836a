"use strict";
(async () => {
const D = JSON.parse(document.getElementById("data").textContent);
const css = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
const el = (tag, text, parent, cls) => {
  const e = document.createElement(tag);
  e.textContent = text; if (cls) e.className = cls;
  parent.append(e); return e;
};
const STATE = {INIT: "#9aa5b1", DISARMED: "#9aa5b1", READY: "#00acc1", SELF_TEST: "#00acc1", ARMED: "#f9ab00", RUNNING: "#34a853",
  STOPPING: "#f9ab00", FAULT_STOP: "#d93025", FAULT_LATCHED: "#d93025", ESTOP: "#d93025"};

// A curve: kinds, then low and high bytes of the differences of 16 bit levels, deflated.
async function unpack(c, slots) {
  const raw = Uint8Array.from(atob(c.data), ch => ch.charCodeAt(0));
  const flow = new Blob([raw]).stream().pipeThrough(new DecompressionStream("deflate"));
  const b = new Uint8Array(await new Response(flow).arrayBuffer());
  const out = new Array(slots), k = (c.high - c.low) / 65535;
  for (let i = 0, level = 0; i < slots; i++) {
    level = (level + b[slots + i] + 256 * b[2 * slots + i]) & 65535;
    out[i] = b[i] === 1 ? c.low + level * k : b[i] === 2 ? null : undefined;
  }
  return out;
}
const instants = g => Float64Array.from({length: g.slots}, (_, i) => g.start + i * g.step);

// --- head
document.getElementById("title").textContent = D.title;
for (const [label, value] of D.facts) {
  const f = el("div", "", document.getElementById("facts"), "card");
  el("b", value, f); el("span", label, f);
}
for (const w of D.warnings) el("div", w, document.getElementById("warnings"), "note");

// --- curves over time
const x = instants(D.grid), end = D.grid.start + D.grid.slots * D.grid.step;
const home = document.getElementById("panels"), plots = [];
let range = [D.grid.start, end], busy = false;
const tint = (u, alpha) => {
  const c = u.ctx, b = u.bbox; c.save(); c.globalAlpha = alpha;
  D.states.forEach(([t, name], i) => {
    const t1 = i + 1 < D.states.length ? D.states[i + 1][0] : end;
    const p0 = Math.max(u.valToPos(t, "x", true), b.left), p1 = Math.min(u.valToPos(t1, "x", true), b.left + b.width);
    if (p1 <= p0) return;
    c.fillStyle = STATE[name] || "#888"; c.fillRect(p0, b.top, p1 - p0, b.height);
    if (alpha < .5) return;
    c.fillStyle = "#10151b"; c.font = `600 ${11 * devicePixelRatio}px system-ui,sans-serif`; c.textBaseline = "middle"; c.textAlign = "left";
    const label = name.toLowerCase().replace("_", " ");
    if (c.measureText(label).width + 10 < p1 - p0) c.fillText(label, p0 + 5, b.top + b.height / 2);
  });
  c.restore();
};
function follow(u, key) {
  if (key !== "x" || busy) return;
  busy = true; range = [u.scales.x.min, u.scales.x.max];
  for (const p of plots) if (p !== u) p.setScale("x", {min: range[0], max: range[1]});
  busy = false; draw();
}
const digits = v => v == null ? "–" : Math.abs(v) >= 1000 ? v.toFixed(0) : v.toPrecision(4).replace(/\.?0+$/, "");
const span = (_, lo, hi) => lo == null ? [0, 1] : hi - lo < 1e-9 ? [lo - 1, hi + 1] : uPlot.rangeNum(lo, hi, .08, true);
function makePlot(panel, data, height, last) {
  const box = el("div", "", home, "panel" + (panel.strip ? " strip" : ""));
  if (panel.title) { const h = el("h2", panel.title + " ", box); if (panel.unit) el("small", panel.unit, h); }
  const axis = {stroke: css("quiet"), grid: {show: !panel.strip, stroke: css("line"), width: 1}, ticks: {stroke: css("line"), width: 1}, font: "11px system-ui,sans-serif"};
  const u = new uPlot({
    width: home.clientWidth, height,
    cursor: {sync: {key: "t"}, drag: {x: true, y: false}, points: {size: 6}, y: false},
    scales: {x: {time: false}, y: {range: panel.strip ? [0, 1] : span}}, padding: [6, 10, 0, 0],
    axes: [{...axis, side: panel.strip ? 0 : 2, size: last || panel.strip ? 26 : 4, values: last || panel.strip ? (_, v) => v.map(t => t + " s") : () => []},
           {...axis, size: 56, show: true, values: panel.strip ? () => [] : undefined, ticks: panel.strip ? {show: false} : axis.ticks}],
    series: [{label: "t"},
      ...panel.curves.map(c => ({label: c.name, stroke: css(c.role), width: c.role === "bound" ? 1 : 1.4,
        dash: c.role === "bound" ? [5, 4] : undefined, points: {show: false}, value: (_, v) => digits(v)}))],
    hooks: {drawClear: [v => tint(v, panel.strip ? .9 : .07)], setScale: [follow], setCursor: [v => point(v)]},
  }, [x, ...data], box);
  plots.push(u); return u;
}

// --- the instant that is shown: chosen by the slider, the arrow keys, or the pointer over a curve or the track
const slider = document.getElementById("time"), clock = document.getElementById("clock");
let now = null;
Object.assign(slider, {min: x[0], max: x[x.length - 1], value: x[0]});
function seek(t) {
  const u = plots[0], half = (range[1] - range[0]) / 2, inside = t >= range[0] && t <= range[1];
  t = Math.min(Math.max(t, x[0]), x[x.length - 1]);
  if (!inside && half * 2 < end - x[0]) {
    const middle = Math.min(Math.max(t, x[0] + half), end - half);
    u.setScale("x", {min: middle - half, max: middle + half});
  }
  requestAnimationFrame(() => { for (const p of plots) p.setCursor({left: p.valToPos(t, "x"), top: 5}); });
}
function point(u) {  // a pointer that leaves the curves leaves the instant where it was
  const left = u.cursor.left, known = left != null && left >= 0;
  if (!known && now !== null && u === plots[0]) seek(now);
  if (known) { now = u.posToVal(left, "x"); requestAnimationFrame(draw); }
}
function showInstant() {
  const last = D.states.findLast(([t]) => t <= now), state = last ? " · " + last[1].toLowerCase().replace("_", " ") : "";
  clock.textContent = now === null ? "slider, or ← →" : `t = ${now.toFixed(2)} s${state}`;
  if (now !== null) { slider.value = now; slider.setAttribute("aria-valuetext", clock.textContent); }
}
slider.addEventListener("input", () => seek(+slider.value));
addEventListener("keydown", e => {
  const way = {ArrowLeft: -1, ArrowRight: 1}[e.key];
  if (!way || e.altKey || e.ctrlKey || e.metaKey || !plots.length) return;
  e.preventDefault(); seek((now ?? +slider.value) + way * (e.shiftKey ? 1 : .05));
});

// --- track
const canvas = document.getElementById("track"), ctx = canvas.getContext("2d");
let tr = null, view = null;
const ramp = f => {  // dark blue, teal, yellow, red: readable on white and on black
  const s = [[38, 70, 160], [30, 150, 160], [240, 180, 40], [210, 40, 40]], p = Math.min(Math.max(f, 0), 1) * 3, i = Math.min(Math.floor(p), 2), w = p - i;
  return `rgb(${s[i].map((a, k) => Math.round(a + w * (s[i + 1][k] - a))).join(",")})`;
};
function fit() {
  const xs = [...(tr ? tr.x : []), ...(D.lane ? D.lane.x : [])].filter(v => v != null), ys = [...(tr ? tr.y : []), ...(D.lane ? D.lane.y : [])].filter(v => v != null);
  const lo = a => a.reduce((m, v) => Math.min(m, v), Infinity), hi = a => a.reduce((m, v) => Math.max(m, v), -Infinity);
  const w = canvas.clientWidth, h = canvas.clientHeight, pad = .5;
  const k = Math.min(w / (hi(xs) - lo(xs) + 2 * pad), h / (hi(ys) - lo(ys) + 2 * pad));
  view = {k, x: (lo(xs) + hi(xs)) / 2, y: (lo(ys) + hi(ys)) / 2};
}
const px = v => canvas.clientWidth / 2 + (v - view.x) * view.k, py = v => canvas.clientHeight / 2 - (v - view.y) * view.k;
function grid() {
  const want = 70 / view.k, p = 10 ** Math.floor(Math.log10(want)), step = [1, 2, 5, 10].map(m => m * p).find(s => s >= want);
  const w = canvas.clientWidth, h = canvas.clientHeight;
  ctx.strokeStyle = css("line"); ctx.fillStyle = css("quiet"); ctx.lineWidth = 1; ctx.font = "11px system-ui,sans-serif";
  const shown = v => +v.toFixed(6) + " m";
  for (let v = Math.ceil((view.x - w / 2 / view.k) / step) * step; px(v) < w; v += step) {
    ctx.beginPath(); ctx.moveTo(px(v), 0); ctx.lineTo(px(v), h); ctx.stroke(); if (px(v) > 44) ctx.fillText(shown(v), px(v) + 3, h - 5);
  }
  for (let v = Math.ceil((view.y - h / 2 / view.k) / step) * step; py(v) > 0; v += step) {
    ctx.beginPath(); ctx.moveTo(0, py(v)); ctx.lineTo(w, py(v)); ctx.stroke(); if (py(v) < h - 20) ctx.fillText(shown(v), 4, py(v) - 3);
  }
}
function lane() {
  if (!D.lane) return;
  ctx.beginPath(); D.lane.x.forEach((v, i) => ctx[i ? "lineTo" : "moveTo"](px(v), py(D.lane.y[i])));
  if (D.lane.closed) ctx.closePath();
  ctx.lineJoin = "round"; ctx.strokeStyle = css("lane"); ctx.lineWidth = Math.max(2 * D.lane.half * view.k, 2); ctx.stroke();
  ctx.strokeStyle = css("centre"); ctx.lineWidth = 1; ctx.setLineDash([6, 5]); ctx.stroke(); ctx.setLineDash([]);
}
function driven(top) {
  const n = tr.t.length, colour = Math.max(top, 1e-9);
  let key = null; ctx.lineWidth = 2.4; ctx.lineJoin = ctx.lineCap = "round";
  for (let pass = 0; pass < 2; pass++) {
    let open = false; key = null;
    for (let i = 1; i < n; i++) {
      const inside = tr.t[i] >= range[0] && tr.t[i] <= range[1];
      const gone = tr.x[i] == null || tr.x[i - 1] == null || (pass === 1) !== inside;
      const k = gone ? null : pass === 0 ? css_far : tr.c[i] == null ? css_plain : ramp(Math.round(24 * tr.c[i] / colour) / 24);
      if (k !== key) { if (open) ctx.stroke(); open = k !== null; if (open) { ctx.strokeStyle = k; ctx.beginPath(); ctx.moveTo(px(tr.x[i - 1]), py(tr.y[i - 1])); } key = k; }
      if (open) ctx.lineTo(px(tr.x[i]), py(tr.y[i]));
    }
    if (open) ctx.stroke();
  }
}
function car(t) {
  const i = Math.min(Math.max(Math.round((t - tr.t[0]) / (tr.t[1] - tr.t[0])), 0), tr.t.length - 1);
  if (tr.x[i] == null) return;
  ctx.save(); ctx.translate(px(tr.x[i]), py(tr.y[i])); ctx.rotate(-tr.yaw[i]);
  const l = Math.max(.33 * view.k, 16), w = l * .55;
  ctx.fillStyle = css("back"); ctx.strokeStyle = css("ink"); ctx.lineWidth = 2;
  ctx.beginPath(); ctx.moveTo(l * .62, 0); ctx.lineTo(-l * .5, w / 2); ctx.lineTo(-l * .32, 0); ctx.lineTo(-l * .5, -w / 2); ctx.closePath(); ctx.fill(); ctx.stroke();
  ctx.restore();
}
let css_far, css_plain;
function draw() {
  showInstant();
  if (!view) return;
  const r = devicePixelRatio; canvas.width = canvas.clientWidth * r; canvas.height = canvas.clientHeight * r;
  ctx.setTransform(r, 0, 0, r, 0, 0); css_far = css("far"); css_plain = css("estimate");
  lane(); grid(); if (tr) { driven(D.track.top); if (now !== null) car(now); }
}
if (D.track) {
  const names = ["x", "y", "yaw", "c"], got = await Promise.all(names.map(n => unpack(D.track[n], D.track.grid.slots)));
  tr = {t: instants(D.track.grid)}; names.forEach((n, i) => { tr[n] = got[i]; });
}
if (tr || D.lane) {
  fit();
  const s = document.getElementById("scale");
  if (D.track) {
    el("span", `${D.track.colour} 0`, s); const bar = el("i", "", s); bar.style.background = `linear-gradient(90deg,${[0, .33, .67, 1].map(ramp).join(",")})`;
    el("span", `${+(D.track.top * D.track.factor).toPrecision(2)} ${D.track.unit}`, s);
  }
  if (D.lane) el("span", `grey: ±${D.lane.half} m of the path`, s, "lane");
  canvas.addEventListener("wheel", e => { e.preventDefault();
    const f = Math.exp(-e.deltaY * .0015), wx = view.x + (e.offsetX - canvas.clientWidth / 2) / view.k, wy = view.y - (e.offsetY - canvas.clientHeight / 2) / view.k;
    view = {k: view.k * f, x: wx + (view.x - wx) / f, y: wy + (view.y - wy) / f}; draw(); }, {passive: false});
  canvas.addEventListener("pointermove", e => {
    if (e.buttons) { view.x -= e.movementX / view.k; view.y += e.movementY / view.k; draw(); return; }
    if (!tr || !plots.length) return;
    let best = 400, at = null;
    for (let i = 0; i < tr.t.length; i++) { if (tr.x[i] == null || tr.t[i] < range[0] || tr.t[i] > range[1]) continue;
      const d = (px(tr.x[i]) - e.offsetX) ** 2 + (py(tr.y[i]) - e.offsetY) ** 2; if (d < best) { best = d; at = tr.t[i]; } }
    if (at !== null) seek(at);
  });
  canvas.addEventListener("dblclick", () => { fit(); draw(); });
} else document.getElementById("left").remove();

if (D.states.length) makePlot({strip: true, title: "", curves: [{name: "state", role: "other"}]}, [new Array(x.length)], 60, false);
for (let i = 0; i < D.panels.length; i++) {
  const p = D.panels[i];
  makePlot(p, await Promise.all(p.curves.map(c => unpack(c, D.grid.slots))), i === D.panels.length - 1 ? 158 : 136, i === D.panels.length - 1);
}
draw();
addEventListener("resize", () => { for (const p of plots) p.setSize({width: home.clientWidth, height: p.height}); if (view) { fit(); draw(); } });
document.documentElement.dataset.ready = String(plots.length);
})().catch(error => { document.getElementById("warnings").textContent = "This page could not be drawn: " + error; throw error; });
