"use strict";
// Drawing on canvases: axes with units, traces, points, pictures. Colours come from the style sheet.

const plots = (() => {
  const look = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

  function steps(low, high, count) {
    const raw = (high - low) / Math.max(1, count);
    const power = Math.pow(10, Math.floor(Math.log10(raw)));
    const step = [1, 2, 5, 10].find((n) => n * power >= raw) * power;
    const found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
    return [found, step];
  }

  function label(value, step) {
    if (Math.abs(value) < 1e-9 * step) return "0";
    if (Math.abs(value) >= 1e5 || step < 1e-4) return value.toExponential(1);
    return value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  }

  // Begins a picture: clears it, draws axes; returns how values become places.
  function begin(canvas, x, y) {
    const ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = look("panel");
    pen.fillRect(0, 0, width, height);
    const box = { left: 58, top: 8, right: width - 12, bottom: height - 38 };
    const px = (v) => box.left + (v - x.low) / (x.high - x.low) * (box.right - box.left);
    const py = (v) => box.bottom - (v - y.low) / (y.high - y.low) * (box.bottom - box.top);
    pen.font = "12px system-ui, 'DejaVu Sans', sans-serif";
    const [xs, xstep] = steps(x.low, x.high, (box.right - box.left) / 70);
    const [ys, ystep] = steps(y.low, y.high, (box.bottom - box.top) / 36);
    pen.strokeStyle = look("grid");
    pen.lineWidth = 1;
    pen.beginPath();
    for (const v of xs) { pen.moveTo(px(v), box.top); pen.lineTo(px(v), box.bottom); }
    for (const v of ys) { pen.moveTo(box.left, py(v)); pen.lineTo(box.right, py(v)); }
    pen.stroke();
    const axes = () => {
      pen.strokeStyle = look("soft");
      pen.lineWidth = 1;
      pen.strokeRect(box.left, box.top, box.right - box.left, box.bottom - box.top);
      pen.fillStyle = look("soft");
      pen.textAlign = "center"; pen.textBaseline = "top";
      for (const v of xs) pen.fillText(label(v, xstep), px(v), box.bottom + 4);
      pen.fillText(x.title, (box.left + box.right) / 2, box.bottom + 20);
      pen.textAlign = "right"; pen.textBaseline = "middle";
      for (const v of ys) pen.fillText(label(v, ystep), box.left - 5, py(v));
      pen.save();
      pen.translate(12, (box.top + box.bottom) / 2);
      pen.rotate(-Math.PI / 2);
      pen.textAlign = "center";
      pen.fillText(y.title, 0, 0);
      pen.restore();
    };
    return { pen, box, px, py, axes };
  }

  function line(view, xs, ys, colour, dash = [], width = 1.5) {
    const { pen, box, px, py } = view;
    pen.save();
    pen.beginPath();
    pen.rect(box.left, box.top, box.right - box.left, box.bottom - box.top);
    pen.clip();
    pen.strokeStyle = look(colour);
    pen.lineWidth = width;
    pen.setLineDash(dash);
    pen.beginPath();
    let down = false;
    for (let k = 0; k < ys.length; k++) {
      if (!Number.isFinite(ys[k])) { down = false; continue; }
      if (down) pen.lineTo(px(xs(k)), py(ys[k])); else pen.moveTo(px(xs(k)), py(ys[k]));
      down = true;
    }
    pen.stroke();
    pen.restore();
  }

  function legend(view, entries) {
    const { pen, box } = view;
    let left = box.left + 8;
    const top = box.top + 10;
    pen.textAlign = "left"; pen.textBaseline = "middle";
    for (const [text, colour, dash] of entries) {
      const width = pen.measureText(text).width;
      pen.fillStyle = look("panel");
      pen.globalAlpha = 0.85;
      pen.fillRect(left - 3, top - 8, width + 34, 16);
      pen.globalAlpha = 1;
      pen.strokeStyle = look(colour); pen.lineWidth = 2; pen.setLineDash(dash);
      pen.beginPath(); pen.moveTo(left, top); pen.lineTo(left + 22, top); pen.stroke(); pen.setLineDash([]);
      pen.fillStyle = look("ink");
      pen.fillText(text, left + 26, top);
      left += width + 42;
    }
  }

  // A range that holds all values, steady while they are within it, so that a picture does not tremble.
  function range(held, values, margin, least) {
    let low = Infinity, high = -Infinity;
    for (const part of values) for (const v of part) if (Number.isFinite(v)) { if (v < low) low = v; if (v > high) high = v; }
    if (low > high) return held || { low: 0, high: 1 };
    const span = Math.max(high - low, least);
    const middle = (low + high) / 2;
    if (held && low >= held.low && high <= held.high && held.high - held.low < 4 * span * (1 + 2 * margin)) return held;
    return { low: middle - span * (0.5 + margin), high: middle + span * (0.5 + margin) };
  }

  // Cividis, by a few of its colours: its order is seen by everybody.
  const cividis = [[0, 34, 78], [53, 69, 108], [102, 105, 112], [148, 142, 119], [200, 184, 102], [254, 232, 56]];
  const colours = new Uint32Array(256);
  for (let k = 0; k < 256; k++) {
    const place = k / 255 * (cividis.length - 1), at = Math.min(cividis.length - 2, Math.floor(place)), part = place - at;
    const [r, g, b] = [0, 1, 2].map((c) => Math.round(cividis[at][c] * (1 - part) + cividis[at + 1][c] * part));
    colours[k] = (255 << 24) | (b << 16) | (g << 8) | r;
  }

  return { look, begin, line, legend, range, colours };
})();
