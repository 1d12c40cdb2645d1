// The map: materials as balls over the expected error, and the point that is moved.

import { inLines, spread } from "./layout.js";
import { fieldAt, reachOf, within } from "./numerics.js";

const MARGIN = 0.12;
const FIELD_SIZE = 64;
const LETTERS = 11; // pixels of a name's line
const HATCH = 9; // pixels between lines where the data do not support predictions
const MOST_COVERED = 0.7; // of the map by balls and names; where it would be more, names are left out

/** Draws the map into a canvas, and converts between its pixels and latents. */
export class MapView {
  constructor(canvas, data) {
    this.canvas = canvas;
    this.data = data;
    this.images = data.names.map(() => null);
    this.setGuests([], []);
    this.zoom = 1;
    const axis = (q) => data.X.map((row) => row[q] ?? 0);
    this.low = [0, 1].map((q) => Math.min(...axis(q)));
    this.high = [0, 1].map((q) => Math.max(...axis(q)));
    for (const q of [0, 1]) {
      if (this.high[q] - this.low[q] < 1e-6) { this.low[q] -= 1; this.high[q] += 1; }
    }
    this.centre = [0, 1].map((q) => (this.low[q] + this.high[q]) / 2);
    this.reach = reachOf(data.X);
  }

  /** Show a material by a picture from now on. */
  showMaterial(k, image) {
    this.images[k] = image;
    this.groundKey = null;
  }

  /** Dropped materials {name, x, image} that stand on the map besides its own, and their indices. */
  setGuests(indices, shown) {
    const { names, X } = this.data;
    this.guests = indices;
    this.names = [...names, ...shown.map(({ name }) => name)];
    this.X = [...X, ...shown.map(({ x }) => x)];
    this.images.splice(names.length, Infinity, ...shown.map(({ image }) => image));
    this.groundKey = this.arranged = null;
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
    this.places.forEach(([x, y], k) => {
      const d = Math.hypot(x - at[0], y - at[1]);
      if (d < least) { best = k; least = d; }
    });
    return best;
  }

  /** Where balls and names stand: near their latents, and not over each other. */
  _arrange(context) {
    const { canvas: { width, height }, ratio } = this, limit = Math.min(width, height);
    const own = this.X.map((row) => this.toPixel(row));
    const share = Math.sqrt((0.16 * width * height) / this.names.length) / 2; // balls cover a sixth of the map at most
    this.radius = Math.min(share, 0.05 * limit) * this.zoom ** 0.25;
    context.font = this.font;
    const lines = this.names.map(inLines), line = LETTERS * ratio * 1.15, ball = 2 * this.radius;
    const widths = lines.map((text) => Math.max(...text.map((row) => context.measureText(row).width)) + 4 * ratio);
    const named = lines.map((text, k) => [Math.max(widths[k], ball), ball + text.length * line]);
    const isInside = ([x, y]) => x >= 0 && x <= width && y >= 0 && y <= height;
    const covered = named.reduce((sum, [w, h], k) => sum + (isInside(own[k]) ? w * h : 0), 0);
    this.lines = covered <= MOST_COVERED * width * height ? lines : lines.map(() => []);
    const room = this.lines.map((text, k) => (text.length ? named[k] : [ball, ball]));
    const below = room.map(([, h]) => (h - ball) / 2); // names hang under their balls
    const centres = spread(own.map(([x, y], k) => [x, y + below[k]]), room, width, height);
    this.places = centres.map(([x, y], k) => [x, y - below[k]]);
  }

  get font() {
    return `${LETTERS * this.ratio}px system-ui, sans-serif`;
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
    const context = this.canvas.getContext("2d");
    this._drawGround(state, theme);
    context.drawImage(this.ground, 0, 0);
    if (state.path) this._drawPath(context, state.path, theme);
    weights.forEach((weight, k) => weight > 0.01 && this._drawWeight(context, k, weight, theme));
    if (state.pin) this._drawMark(context, state.pin.x, theme.pin, "square");
    this._drawMark(context, state.x, theme.point, "ring");
    if (hover >= 0) this._drawLabel(context, hover, theme);
  }

  /** Materials that are no landmarks, as points in their colours. */
  _drawOthers(context) {
    const { X, colours } = this.data.others, radius = Math.max(this.ratio, 0.12 * this.radius);
    X.forEach((x, k) => {
      const [px, py] = this.toPixel(x);
      context.fillStyle = colours[k];
      context.fillRect(px - radius, py - radius, 2 * radius, 2 * radius);
    });
  }

  /** What does not move with the point, drawn when it changes: the field of errors, balls and names. */
  _drawGround(state, theme) {
    const { width, height } = this.canvas;
    const key = JSON.stringify([state.x.slice(2), theme.name, this.scale, this.centre, width, height, this.images.length]);
    if (this.groundKey === key) return;
    this.groundKey = key;
    this.ground ??= document.createElement("canvas");
    Object.assign(this.ground, { width, height });
    const context = this.ground.getContext("2d"), { names, X } = this;
    const arranged = JSON.stringify([this.scale, this.centre, width, height]);
    if (this.arranged !== arranged) this._arrange(context);
    this.arranged = arranged;
    this._drawField(context, state, theme);
    this._drawOthers(context);
    const order = X.map((_, k) => k).sort((a, b) => this._depth(a, state) - this._depth(b, state));
    for (const k of order) this._drawMaterial(context, k, state, theme);
    names.forEach((_, k) => this._drawLeader(context, k, theme)); // over the balls, which would hide them where it is crowded
  }

  /** How near a material is in the dimensions that are not drawn, 1 at the same. */
  _depth(k, state) {
    const rest = this.X[k].slice(2).reduce((s, v, q) => s + (v - state.x[q + 2]) ** 2, 0);
    return Math.exp(-rest / 2);
  }

  _drawField(context, state, theme) {
    const { data: { error }, canvas: { width, height } } = this;
    if (!error) return;
    const ground = new ImageData(FIELD_SIZE, FIELD_SIZE), mask = new ImageData(FIELD_SIZE, FIELD_SIZE);
    const { most } = error, unsupported = { ...error, values: error.unsupported }, x = [...state.x];
    for (let row = 0; row < FIELD_SIZE; row++) {
      for (let column = 0; column < FIELD_SIZE; column++) {
        x[0] = this.centre[0] + (((column + 0.5) / FIELD_SIZE - 0.5) * width) / this.scale;
        if (x.length > 1) x[1] = this.centre[1] - (((row + 0.5) / FIELD_SIZE - 0.5) * height) / this.scale;
        const at = this.clamped(x); // beyond the reach of the point: the error where a drag ends
        const share = Math.min(Math.max((fieldAt(error, at) ?? most) / most, 0), 1);
        const k = 4 * (row * FIELD_SIZE + column);
        for (let c = 0; c < 3; c++) ground.data[k + c] = theme.certain[c] + (theme.uncertain[c] - theme.certain[c]) * share;
        ground.data[k + 3] = 255;
        mask.data[k + 3] = 255 * (fieldAt(unsupported, at) ?? 1);
      }
    }
    this._stretch(context, ground);
    const hatched = document.createElement("canvas");
    Object.assign(hatched, { width, height });
    const lines = hatched.getContext("2d");
    lines.strokeStyle = theme.hatch;
    lines.lineWidth = this.ratio;
    lines.beginPath();
    for (let start = -height; start < width; start += HATCH * this.ratio) {
      lines.moveTo(start, height);
      lines.lineTo(start + height, 0);
    }
    lines.stroke();
    lines.globalCompositeOperation = "destination-in";
    this._stretch(lines, mask);
    context.drawImage(hatched, 0, 0);
  }

  /** Draw a small picture over a whole canvas. */
  _stretch(context, image) {
    const small = document.createElement("canvas");
    Object.assign(small, { width: image.width, height: image.height });
    small.getContext("2d").putImageData(image, 0, 0);
    context.imageSmoothingEnabled = true;
    context.imageSmoothingQuality = "high";
    context.drawImage(small, 0, 0, context.canvas.width, context.canvas.height);
  }

  _drawPath(context, path, theme) {
    const ends = [path.from, path.to].map((name) => this.toPixel(this.data.X[this.names.indexOf(name)]));
    context.strokeStyle = theme.point;
    context.setLineDash([6 * this.ratio, 5 * this.ratio]);
    context.lineWidth = 1.5 * this.ratio;
    context.beginPath();
    context.moveTo(...ends[0]);
    context.lineTo(...ends[1]);
    context.stroke();
    context.setLineDash([]);
  }

  /** A line from a ball that was moved aside to where it belongs. */
  _drawLeader(context, k, theme) {
    const own = this.toPixel(this.X[k]), place = this.places[k], apart = Math.hypot(own[0] - place[0], own[1] - place[1]);
    if (apart <= this.radius) return; // the ball covers its point
    const edge = place.map((p, axis) => p + (this.radius / apart) * (own[axis] - p));
    for (const [style, extra] of [[theme.panel, 1.5], [theme.ink, 0]]) { // an outline, then the line
      context.strokeStyle = context.fillStyle = style;
      context.lineWidth = (1 + extra) * this.ratio;
      context.beginPath();
      context.moveTo(...own);
      context.lineTo(...edge);
      context.stroke();
      context.beginPath();
      context.arc(...own, (2.5 + extra / 2) * this.ratio, 0, 2 * Math.PI);
      context.fill();
    }
  }

  _drawMaterial(context, k, state, theme) {
    const [px, py] = this.places[k], r = this.radius, { ratio } = this;
    context.globalAlpha = 0.2 + 0.8 * this._depth(k, state);
    if (this.images[k]) {
      context.drawImage(this.images[k], px - r, py - r, 2 * r, 2 * r);
    } else {
      context.fillStyle = theme.rule;
      context.beginPath();
      context.arc(px, py, r * 0.9, 0, 2 * Math.PI);
      context.fill();
    }
    context.font = this.font;
    context.textAlign = "center";
    context.textBaseline = "top";
    context.lineJoin = "round";
    context.lineWidth = 3 * ratio;
    context.strokeStyle = theme.panel;
    context.fillStyle = theme.ink;
    this.lines[k].forEach((text, row) => {
      const at = [px, py + r + (1 + row * 1.15 * LETTERS) * ratio];
      context.strokeText(text, ...at);
      context.fillText(text, ...at);
    });
    context.globalAlpha = 1;
    context.textAlign = "start";
  }

  _drawWeight(context, k, weight, theme) {
    context.strokeStyle = theme.point;
    context.lineWidth = (0.75 + 3 * weight) * this.ratio;
    context.beginPath();
    context.arc(...this.places[k], this.radius + context.lineWidth / 2, 0, 2 * Math.PI);
    context.stroke();
  }

  _drawMark(context, x, colour, shape) {
    const [px, py] = this.toPixel(x), size = Math.max(0.45 * this.radius, 7 * this.ratio);
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
    const [px, py] = this.places[k], { ratio } = this;
    context.font = `${13 * ratio}px system-ui, sans-serif`;
    const name = this.names[k], width = context.measureText(name).width + 12 * ratio, height = 22 * ratio;
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
