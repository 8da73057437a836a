// What a reader would call broken on a page: text over text, text cut off or beyond the edge, and
// text too pale to read on its ground. The value is a list of sentences, empty for a good page.
(() => {
  const faults = [], texts = [], wide = document.documentElement.clientWidth;
  const name = e => (e.id ? "#" + e.id : e.tagName.toLowerCase() + (e.className.baseVal ?? e.className ? "." + String(e.className.baseVal ?? e.className).trim().replace(/\s+/g, ".") : ""));
  const seen = e => e.checkVisibility({contentVisibilityAuto: true, opacityProperty: true, visibilityProperty: true});
  // A box that scrolls may hold more than it shows; what it hides is out of view, not cut off.
  const port = e => { for (let p = e.parentElement; p; p = p.parentElement) if (/auto|scroll/.test(getComputedStyle(p).overflowX)) return p; return null; };
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node; (node = walk.nextNode());) {
    const e = node.parentElement;
    if (!node.data.trim() || /^(SCRIPT|STYLE|NOSCRIPT|TITLE|DESC)$/i.test(e.tagName) || !seen(e)) continue;
    const range = document.createRange(); range.selectNodeContents(node);
    for (const r of range.getClientRects()) if (r.width > 1 && r.height > 1) texts.push({e, r, t: node.data.trim().slice(0, 40)});
  }
  if (document.documentElement.scrollWidth > wide + 1) faults.push(`the page is ${document.documentElement.scrollWidth} px wide in a window of ${wide}`);
  for (const {e, r, t} of texts) {
    const p = port(e);
    if (!p && (r.left < -1 || r.right > wide + 1)) faults.push(`beyond the edge: "${t}" in ${name(e)}`);
    const svg = e.closest("svg");
    if (svg) { const s = svg.getBoundingClientRect();
      if (r.left < s.left - 2 || r.right > s.right + 2 || r.top < s.top - 3 || r.bottom > s.bottom + 3) faults.push(`cut off by its figure: "${t}"`); }
    for (let q = e; q && q !== document.body; q = q.parentElement) {
      const s = getComputedStyle(q);
      if (s.overflowX === "hidden" && q.scrollWidth > q.clientWidth + 1) { faults.push(`cut off by ${name(q)}: "${t}"`); break; }
    }
  }
  const inside = 2;  // line boxes may touch
  texts.sort((a, b) => a.r.top - b.r.top);
  for (let i = 0; i < texts.length; i++) for (let j = i + 1; j < texts.length && texts[j].r.top < texts[i].r.bottom - inside; j++) {
    const a = texts[i], b = texts[j];
    if (a.e === b.e || a.e.contains(b.e) || b.e.contains(a.e)) continue;
    if (port(a.e) !== port(b.e)) { // scrolled away behind an edge
      const hidden = [a, b].some(x => { const p = port(x.e); if (!p) return false; const v = p.getBoundingClientRect(); return x.r.left >= v.right || x.r.right <= v.left; });
      if (hidden) continue;
    }
    const w = Math.min(a.r.right, b.r.right) - Math.max(a.r.left, b.r.left), h = Math.min(a.r.bottom, b.r.bottom) - Math.max(a.r.top, b.r.top);
    if (w > inside && h > inside + 1) faults.push(`"${a.t}" lies over "${b.t}" (${name(a.e)}, ${name(b.e)}; ${Math.round(w)} x ${Math.round(h)} px)`);
  }
  // Contrast after WCAG 2.1: 3 to 1 for anything that is read.
  const paint = document.createElement("canvas").getContext("2d", {willReadFrequently: true});
  const rgb = c => { paint.clearRect(0, 0, 1, 1); paint.fillStyle = c; paint.fillRect(0, 0, 1, 1); return [...paint.getImageData(0, 0, 1, 1).data]; };
  const light = c => { const [r, g, b] = c.map(v => (v /= 255) <= .03928 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4); return .2126 * r + .7152 * g + .0722 * b; };
  const ground = e => { for (let p = e; p; p = p.parentElement) { const c = rgb(getComputedStyle(p).backgroundColor); if (c[3] > 200) return c; } return [255, 255, 255, 255]; };
  for (const {e, r, t} of texts) {
    const behind = e.closest("svg") ? [...e.closest("svg").querySelectorAll("image")] : [];
    if (behind.some(i => { const b = i.getBoundingClientRect(); return b.left < r.left && b.right > r.right && b.top < r.top && b.bottom > r.bottom; })) continue;
    const s = getComputedStyle(e), c = rgb(e.closest("svg") ? s.fill : s.color), g = ground(e.closest("svg") ? e.closest("svg") : e);
    const [hi, lo] = [light(c), light(g)].sort((x, y) => y - x), ratio = (hi + .05) / (lo + .05);
    if (ratio < 3) faults.push(`too pale (${ratio.toFixed(1)} to 1): "${t}" in ${name(e)}`);
  }
  return [...new Set(faults)];
})()
