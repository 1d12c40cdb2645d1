// The map: materials as balls over the expected error, and the point that is moved.

import { fieldAt, reachOf, within } from "./numerics.js";

const MARGIN = 0.12;
const FIELD_SIZE = 64;

/** Draws the map into a canvas, and converts between its pixels and latents. */
export class MapView {
  constructor(canvas, data) {
    this.canvas = canvas;
    this.data = data;
    this.images = data.names.map(() => null);
    this.zoom = 1;
    const axis = (q) => data.X.map((row) => row[q] ?? 0);
    this.low = [0, 1].map((q) => Math.min(...axis(q)));
    this.high = [0, 1].map((q) => Math.max(...axis(q)));
    for (const q of [0, 1]) {
      if (this.high[q] - this.low[q] < 1e-6) { this.low[q] -= 1; this.high[q] += 1; }
    }
    this.centre = [0, 1].map((q) => (this.low[q] + this.high[q]) / 2);
    this.spacing = this._spacing();
    this.reach = reachOf(data.X);
  }

  /** Median distance of a material to its nearest neighbour on the map. */
  _spacing() {
    const { X } = this.data;
    const nearest = X.map((a, i) => Math.min(...X.map((b, j) =>
      i === j ? Infinity : Math.hypot(a[0] - b[0], (a[1] ?? 0) - (b[1] ?? 0)))));
    return nearest.sort((a, b) => a - b)[Math.floor(nearest.length / 2)];
  }

  /** Fit the canvas to its box; pixels per unit of the map. */
  layout() {
    const { canvas } = this, ratio = window.devicePixelRatio || 1;
    const width = Math.max(Math.round(canvas.clientWidth * ratio), 2);
    const height = Math.max(Math.round(canvas.clientHeight * ratio), 2);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const spans = [0, 1].map((q) => (this.high[q] - this.low[q]) * (1 + 2 * MARGIN));
    this.ratio = ratio;
    this.scale = this.zoom * Math.min(width / spans[0], height / spans[1]);
  }

  toPixel(x) {
    const { canvas, scale, centre } = this;
    return [canvas.width / 2 + (x[0] - centre[0]) * scale, canvas.height / 2 - ((x[1] ?? 0) - centre[1]) * scale];
  }

  /** Place of an event on the canvas, its other coordinates those of x, inside the field of the map. */
  toPlace(event, x) {
    const box = this.canvas.getBoundingClientRect(), { ratio, scale, centre, canvas } = this;
    const across = (event.clientX - box.left) * ratio, down = (event.clientY - box.top) * ratio;
    const place = [...x];
    place[0] = centre[0] + (across - canvas.width / 2) / scale;
    if (x.length > 1) place[1] = centre[1] - (down - canvas.height / 2) / scale;
    return this.clamped(place);
  }

  clamped(x) {
    return within(this.reach, x);
  }

  /** The material under an event, or -1. */
  materialUnder(event) {
    const box = this.canvas.getBoundingClientRect();
    const at = [(event.clientX - box.left) * this.ratio, (event.clientY - box.top) * this.ratio];
    let best = -1, least = this.radius * 1.1;
    this.data.X.forEach((row, k) => {
      const [px, py] = this.toPixel(row), d = Math.hypot(px - at[0], py - at[1]);
      if (d < least) { best = k; least = d; }
    });
    return best;
  }

  get radius() {
    const limit = Math.min(this.canvas.width, this.canvas.height);
    return Math.min(Math.max(0.5 * this.spacing * this.scale, 0.028 * limit), 0.055 * limit * Math.sqrt(this.zoom));
  }

  /** Zoom by a factor, the given place kept in the middle where zoomed in. */
  zoomTo(zoom, x) {
    this.zoom = Math.min(Math.max(zoom, 1), 12);
    this.centre = this.zoom === 1 ? [0, 1].map((q) => (this.low[q] + this.high[q]) / 2) : [x[0], x[1] ?? 0];
  }

  keepInView(x) {
    if (this.zoom === 1) return;
    this.layout();
    const [px, py] = this.toPixel(x), { width, height } = this.canvas;
    if (px < 0.08 * width || px > 0.92 * width || py < 0.08 * height || py > 0.92 * height) {
      this.centre = [x[0], x[1] ?? 0];
    }
  }

  /** Draw everything. */
  draw(state, { hover, weights, theme }) {
    this.layout();
    const context = this.canvas.getContext("2d"), { width, height } = this.canvas;
    context.clearRect(0, 0, width, height);
    this._drawField(context, state, theme);
    if (state.path) this._drawPath(context, state.path, theme);
    const r = this.radius;
    const order = this.data.X.map((_, k) => k).sort((a, b) => this._depth(a, state) - this._depth(b, state));
    for (const k of order) this._drawMaterial(context, k, r, state, weights, theme);
    if (state.pin) this._drawMark(context, state.pin.x, theme.pin, "square", r);
    this._drawMark(context, state.x, theme.point, "ring", r);
    if (hover >= 0) this._drawLabel(context, hover, theme);
  }

  /** How near a material is in the dimensions that are not drawn, 1 at the same. */
  _depth(k, state) {
    const rest = this.data.X[k].slice(2).reduce((s, v, q) => s + (v - state.x[q + 2]) ** 2, 0);
    return Math.exp(-rest / 2);
  }

  _drawField(context, state, theme) {
    const { error } = this.data;
    if (!error) return;
    const key = JSON.stringify([state.x.slice(2), theme.name, this.scale, this.centre, this.canvas.width, this.canvas.height]);
    if (this.fieldKey !== key) {
      const image = new ImageData(FIELD_SIZE, FIELD_SIZE);
      const { most } = error;
      const x = [...state.x];
      for (let row = 0; row < FIELD_SIZE; row++) {
        for (let column = 0; column < FIELD_SIZE; column++) {
          x[0] = this.centre[0] + (((column + 0.5) / FIELD_SIZE - 0.5) * this.canvas.width) / this.scale;
          if (x.length > 1) x[1] = this.centre[1] - (((row + 0.5) / FIELD_SIZE - 0.5) * this.canvas.height) / this.scale;
          // Beyond the reach of the point: the error where a drag ends.
          const share = Math.min(Math.max((fieldAt(error, this.clamped(x)) ?? most) / most, 0), 1);
          const k = 4 * (row * FIELD_SIZE + column);
          for (let c = 0; c < 3; c++) image.data[k + c] = theme.certain[c] + (theme.uncertain[c] - theme.certain[c]) * share;
          image.data[k + 3] = 255;
        }
      }
      this.field ??= document.createElement("canvas");
      Object.assign(this.field, { width: FIELD_SIZE, height: FIELD_SIZE });
      this.field.getContext("2d").putImageData(image, 0, 0);
      this.fieldKey = key;
    }
    context.imageSmoothingEnabled = true;
    context.imageSmoothingQuality = "high";
    context.drawImage(this.field, 0, 0, this.canvas.width, this.canvas.height);
  }

  _drawPath(context, path, theme) {
    const ends = [path.from, path.to].map((name) => this.toPixel(this.data.X[this.data.names.indexOf(name)]));
    context.strokeStyle = theme.point;
    context.setLineDash([6 * this.ratio, 5 * this.ratio]);
    context.lineWidth = 1.5 * this.ratio;
    context.beginPath();
    context.moveTo(...ends[0]);
    context.lineTo(...ends[1]);
    context.stroke();
    context.setLineDash([]);
  }

  _drawMaterial(context, k, r, state, weights, theme) {
    const [px, py] = this.toPixel(this.data.X[k]);
    context.globalAlpha = 0.2 + 0.8 * this._depth(k, state);
    if (this.images[k]) {
      context.drawImage(this.images[k], px - r, py - r, 2 * r, 2 * r);
    } else {
      context.fillStyle = theme.rule;
      context.beginPath();
      context.arc(px, py, r * 0.9, 0, 2 * Math.PI);
      context.fill();
    }
    context.globalAlpha = 1;
    if (weights[k] > 0.01) {
      context.strokeStyle = theme.point;
      context.lineWidth = (0.75 + 3 * weights[k]) * this.ratio;
      context.beginPath();
      context.arc(px, py, r + context.lineWidth / 2, 0, 2 * Math.PI);
      context.stroke();
    }
  }

  _drawMark(context, x, colour, shape, r) {
    const [px, py] = this.toPixel(x), size = Math.max(0.45 * r, 7 * this.ratio);
    for (const [stroke, width] of [["#000", 5], ["#fff", 3.5], [colour, 2]]) {
      context.strokeStyle = stroke;
      context.lineWidth = width * this.ratio;
      context.beginPath();
      if (shape === "ring") {
        context.arc(px, py, size, 0, 2 * Math.PI);
        for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
          context.moveTo(px + dx * size * 0.6, py + dy * size * 0.6);
          context.lineTo(px + dx * size * 1.6, py + dy * size * 1.6);
        }
      } else {
        context.rect(px - size * 0.8, py - size * 0.8, size * 1.6, size * 1.6);
      }
      context.stroke();
    }
  }

  _drawLabel(context, k, theme) {
    const [px, py] = this.toPixel(this.data.X[k]), { ratio } = this;
    context.font = `${13 * ratio}px system-ui, sans-serif`;
    const name = this.data.names[k], width = context.measureText(name).width + 12 * ratio, height = 22 * ratio;
    const left = Math.min(Math.max(px - width / 2, 2), this.canvas.width - width - 2);
    const top = py - this.radius - height - 4 * ratio < 2 ? py + this.radius + 4 * ratio : py - this.radius - height - 4 * ratio;
    context.fillStyle = theme.panel;
    context.strokeStyle = theme.rule;
    context.lineWidth = ratio;
    context.beginPath();
    context.roundRect(left, top, width, height, 4 * ratio);
    context.fill();
    context.stroke();
    context.fillStyle = theme.ink;
    context.textBaseline = "middle";
    context.fillText(name, left + 6 * ratio, top + height / 2);
  }
}
