"use strict";
(() => {
const $ = id => document.getElementById(id), J = JSON.parse($("job").textContent);
const css = n => getComputedStyle(document.documentElement).getPropertyValue("--" + n).trim();
const HOLD_MS = 50, LOST_MS = 500, TRAIL = 4000, SPAN_S = 20;
let last = null, heard = 0, holding = false, socket = null, timer = 0;
const trail = [], errors = [];
$("car").textContent = J.car; document.title = `${J.car} · steerd`;

// --- the wire: words out, pictures in
const say = word => { if (socket && socket.readyState === 1) socket.send(word); };
function connect() {
  socket = new WebSocket(`ws://${location.host}${location.pathname}live`);
  socket.onmessage = e => { last = JSON.parse(e.data); heard = performance.now(); take(last); };
  socket.onclose = () => { release(); setTimeout(connect, 1000); };
}
// The lease: as long as this page is looked at it says so; a page that is closed, hidden or frozen is silent.
function hold() { if (!holding) { holding = true; timer = setInterval(() => say("keepalive"), HOLD_MS); } }
function release() { holding = false; clearInterval(timer); }
function leave() { if (holding) { say("stop"); release(); } }
addEventListener("pagehide", leave);
document.addEventListener("visibilitychange", () => { if (document.hidden) leave(); });
$("estop").onclick = () => say("estop");
$("stop").onclick = () => { say("stop"); };
$("clear").onclick = () => say("clear");
$("arm").onclick = () => { hold(); say("arm"); };
$("start").onclick = () => { hold(); say("start"); };

// --- live parameters: what was edited goes to the car, which answers; the rest shows what is set
const LIVE = { speed: [1, 2], offset: [1000, 0], gain: [1, 2] }, edited = new Set();
for (const name of Object.keys(LIVE)) $(`live-${name}`).addEventListener("input", () => edited.add(name));
$("live").addEventListener("submit", e => {
  e.preventDefault();
  for (const name of edited) { const v = $(`live-${name}`).valueAsNumber; if (Number.isFinite(v)) say(`set ${name} ${+(v / LIVE[name][0]).toPrecision(9)}`); }
  edited.clear(); document.activeElement.blur();
});
function takeLive(live) {
  $("live").hidden = live.speed == null || live.speed[1] == null;
  if ($("live").hidden) return;
  for (const [name, [factor, digits]] of Object.entries(LIVE)) {
    const box = $(`live-${name}`), [now, least, most] = live[name].map(v => (factor * v).toFixed(digits));
    box.title = `${least} to ${most}`; if (!edited.has(name)) box.value = now;
  }
  $("live-answer").textContent = live.text; $("live-answer").className = live.refused ? "refused" : "";
}

// --- what is shown
const show = (v, digits, unit) => v == null ? "–" : `${(+v.toFixed(digits) || 0).toFixed(digits)} ${unit}`;  // no "-0.00" of a car that stands
const cells = {};
for (const label of ["lateral error", "heading error", "speed", "steering", "battery", "motor", "mocap"]) {
  const box = document.createElement("div"), dt = document.createElement("dt"), dd = document.createElement("dd");
  dt.textContent = label; dd.textContent = "–"; box.append(dt, dd); $("figures").append(box); cells[label] = dd;
}
const DEG = 180 / Math.PI;
function take(s) {
  $("state").textContent = s.state.toLowerCase().replace("_", " ") || "–"; $("state").className = s.state;
  const stopped = ["FAULT_STOP", "FAULT_LATCHED", "ESTOP"].includes(s.state);
  $("wait").textContent = s.waiting && s.state !== "RUNNING" ? `waiting for ${s.waiting}` : stopped ? s.reason : "";
  const alarms = [...(stopped ? [s.reason] : []), ...(s.fault ? [`VESC: ${s.fault}`] : []), ...s.warnings.split("\n").filter(Boolean)];
  $("alarm").hidden = !alarms.length; $("alarm").textContent = alarms.join(" · ");
  cells["lateral error"].textContent = show(s.e1 == null ? null : 1000 * s.e1, 1, "mm");
  cells["heading error"].textContent = show(s.e2 == null ? null : DEG * s.e2, 1, "°");
  cells.speed.textContent = show(s.speed, 2, "m/s");
  cells.steering.textContent = show(s.steer == null ? null : DEG * s.steer, 1, "°");
  cells.battery.textContent = show(s.battery, 1, "V"); cells.motor.textContent = show(s.amps, 1, "A");
  cells.mocap.textContent = s.mocap_rate_hz ? `${s.mocap_rate_hz} Hz` : s.mocap || "–";
  $("hold").textContent = holder(s);
  $("arm").disabled = s.state !== "READY"; $("start").disabled = !(s.state === "ARMED" && s.mine);
  $("clear").disabled = !stopped;
  if (holding && !s.mine && ["DISARMED", "READY", "INIT"].includes(s.state) && performance.now() - asked > 1500) release();
  if (s.x != null) { trail.push([s.x, s.y]); if (trail.length > TRAIL) trail.shift(); }
  errors.push([performance.now() / 1000, s.state === "RUNNING" ? s.e1 : null]);
  while (errors.length && errors[0][0] < errors[errors.length - 1][0] - SPAN_S) errors.shift();
  takeLive(s.live);
  $("events").replaceChildren(...s.events.map(t => { const li = document.createElement("li"); li.textContent = t; return li; }).reverse());
}
// Without a lease, as on simulated hardware, a silent holder stops nothing; this page's leaving does, if it drove.
function holder(s) {
  if (s.leased === "0" && !holding) return "This car needs no holder and drives on when this page is closed. Stop and emergency stop work for everybody.";
  if (s.mine) return "You hold this car: close or leave this page and it stops.";
  return s.held ? "Somebody else holds this car. Stop and emergency stop work for everybody." : "Nobody holds this car.";
}
let asked = 0;
for (const id of ["arm", "start"]) $(id).addEventListener("click", () => { asked = performance.now(); });

// --- drawing
function pen(id) {
  const c = $(id), r = devicePixelRatio; c.width = c.clientWidth * r; c.height = c.clientHeight * r;
  const g = c.getContext("2d"); g.setTransform(r, 0, 0, r, 0, 0); g.lineJoin = g.lineCap = "round"; return [g, c.clientWidth, c.clientHeight];
}
function drawTrack() {
  const [g, w, h] = pen("track"), points = [...J.lane, ...(J.lane.length ? [] : trail)];
  if (!points.length) return;
  let x0 = Infinity, x1 = -Infinity, y0 = Infinity, y1 = -Infinity;
  for (const [x, y] of points) { x0 = Math.min(x0, x); x1 = Math.max(x1, x); y0 = Math.min(y0, y); y1 = Math.max(y1, y); }
  const k = Math.min(w / (x1 - x0 + 1.2), h / (y1 - y0 + 1.2)), px = x => w / 2 + (x - (x0 + x1) / 2) * k, py = y => h / 2 - (y - (y0 + y1) / 2) * k;
  const trace = list => { g.beginPath(); list.forEach(([x, y], i) => g[i ? "lineTo" : "moveTo"](px(x), py(y))); };
  if (J.lane.length) {
    trace(J.lane); if (J.closed) g.closePath();
    g.strokeStyle = css("lane"); g.lineWidth = Math.max(2 * J.half_width * k, 2); g.stroke();
    g.strokeStyle = css("quiet"); g.lineWidth = 1; g.setLineDash([6, 5]); g.stroke(); g.setLineDash([]);
  }
  trace(trail); g.strokeStyle = css("before"); g.lineWidth = 2; g.stroke();
  if (last && last.x != null) {
    g.save(); g.translate(px(last.x), py(last.y)); g.rotate(-last.yaw);
    const l = Math.max((J.body.lf + J.body.lr) * k, 16), b = l * .55; g.fillStyle = css("back"); g.strokeStyle = css("ink"); g.lineWidth = 2;
    g.beginPath(); g.moveTo(l * .62, 0); g.lineTo(-l * .5, b / 2); g.lineTo(-l * .32, 0); g.lineTo(-l * .5, -b / 2); g.closePath(); g.fill(); g.stroke(); g.restore();
  }
}
function drawCurve() {
  const [g, w, h] = pen("curve"), top = Math.max(.02, ...errors.map(([, v]) => Math.abs(v ?? 0))) * 1.1, now = errors.length ? errors[errors.length - 1][0] : 0;
  g.strokeStyle = css("line"); g.lineWidth = 1; g.beginPath(); g.moveTo(0, h / 2); g.lineTo(w, h / 2); g.stroke();
  g.strokeStyle = css("before"); g.lineWidth = 1.5; g.beginPath(); let open = false;
  for (const [t, v] of errors) { if (v == null) { open = false; continue; } const x = w - (now - t) / SPAN_S * w, y = h / 2 - v / top * h / 2; g[open ? "lineTo" : "moveTo"](x, y); open = true; }
  g.stroke(); g.fillStyle = css("quiet"); g.font = "11px system-ui,sans-serif"; g.fillText(`±${(1000 * top).toFixed(0)} mm`, 6, 14);
}
function frame() {
  const silent = last === null || performance.now() - heard > LOST_MS || last.silent > LOST_MS / 1000;
  if (silent) { $("alarm").hidden = false; $("alarm").textContent = last === null ? "no message from the car yet" : "no message from the car: is steerd still running?"; }
  drawTrack(); drawCurve(); document.documentElement.dataset.ready = last === null ? "" : "1"; requestAnimationFrame(frame);
}
connect(); requestAnimationFrame(frame);
})();
