// The state of the page as one object, its history, and its form as the fragment of a link.

import { SHAPES } from "./shapes.js";
import { reachOf, within } from "./numerics.js";

/** The state at the start: the material nearest to the middle of the map. */
export function initialState(data) {
  const Q = data.X[0].length;
  const middle = Array.from({ length: Q }, (_, q) => data.X.reduce((s, row) => s + row[q], 0) / data.X.length);
  return {
    x: middle, colour: "blend", like: data.names[0], srgb: "#c08040", spectrum: null, light: "studio", turn: 0, lamp: [-0.4, 0.5],
    shape: "ball", turnShape: 30, illuminant: "D65", exposure: 0, pin: null, path: null,
  };
}

const numbers = (text, count) => {
  const values = (text ?? "").split(",").map(Number);
  return text && values.length === count && values.every(Number.isFinite) ? values : null;
};

/** A lamp inside the disc of directions that face the viewer. */
export function lampWithin([x, y]) {
  const r = Math.max(Math.hypot(x, y) / 0.97, 1);
  return [x / r, y / r];
}

/** Whether a state or pin has the colours between two materials. */
export const isBetween = ({ colour, path }) => colour === "blend" && Boolean(path) && path.t > 0 && path.t < 1;

/** A state as the fragment of a link, without what is as at the start. */
export function toFragment(state) {
  const parts = new URLSearchParams();
  const place = (x) => x.map((v) => String(Number(v.toFixed(4)))).join(",");
  parts.set("x", state.at ?? place(state.x));
  if (state.colour === "like") parts.set("like", state.like);
  if (state.colour === "picked") parts.set("srgb", state.srgb);
  if (state.light === "lamp") parts.set("lamp", place(state.lamp));
  else if (state.light !== "studio") parts.set("light", state.light);
  if (state.turn) parts.set("turn", state.turn);
  if (state.shape !== "ball") parts.set("shape", `${state.shape},${state.turnShape}`);
  if (state.illuminant !== "D65") parts.set("illuminant", state.illuminant);
  if (state.exposure) parts.set("exposure", state.exposure);
  if (state.pin) {
    parts.set("pin", state.pin.at ?? place(state.pin.x));
    if (state.pin.colour === "like") parts.set("pin-like", state.pin.like);
    if (state.pin.colour === "picked") parts.set("pin-srgb", state.pin.srgb);
    if (state.pin.path) parts.set("pin-path", written(state.pin.path));
  }
  if (state.path) parts.set("path", written(state.path));
  return parts.toString();
}

const written = ({ from, to, t }) => JSON.stringify([from, to, t]);

/** The state of a fragment; whatever is not understood stays as at the start, and places stay within reach. */
export function fromFragment(fragment, data) {
  const state = initialState(data), Q = data.X[0].length;
  const parts = new URLSearchParams(fragment.replace(/^#/, ""));
  const known = (name) => data.names.includes(name);
  const colour = (name) => (/^#[0-9a-f]{6}$/i.test(name ?? "") ? name : null);
  const place = (text) => {
    if (known(text)) return { at: text, x: [...data.X[data.names.indexOf(text)]] };
    const x = numbers(text, Q);
    return x && { x: within(reachOf(data.X), x) };
  };
  const path = (key) => {
    try {
      const [from, to, t] = JSON.parse(parts.get(key));
      if (!(known(from) && known(to) && Number.isFinite(t) && t >= 0 && t <= 1)) return { path: null };
      const [a, b] = [from, to].map((name) => data.X[data.names.indexOf(name)]);
      const between = t > 0 && t < 1 ? { x: a.map((v, q) => v + t * (b[q] - v)), at: undefined } : {};
      return { ...between, path: { from, to, t } }; // the place is that of the path, however x was rounded
    } catch {
      return { path: null };
    }
  };
  Object.assign(state, place(parts.get("x")));
  if (known(parts.get("like"))) Object.assign(state, { colour: "like", like: parts.get("like") });
  if (colour(parts.get("srgb"))) Object.assign(state, { colour: "picked", srgb: parts.get("srgb") });
  const lamp = numbers(parts.get("lamp"), 2);
  if (lamp) Object.assign(state, { light: "lamp", lamp: lampWithin(lamp) });
  else if (data.environments.some(({ name }) => name === parts.get("light"))) state.light = parts.get("light");
  const degrees = (text) => Math.min(Math.max(Math.round(Number(text)) || 0, -180), 180);
  state.turn = degrees(parts.get("turn"));
  const [shape, turnShape] = (parts.get("shape") ?? "").split(",");
  if (SHAPES.includes(shape)) Object.assign(state, { shape, turnShape: degrees(turnShape) });
  if (Object.hasOwn(data.toSrgb, parts.get("illuminant"))) state.illuminant = parts.get("illuminant");
  const exposure = Number(parts.get("exposure"));
  if (Number.isFinite(exposure)) state.exposure = Math.min(Math.max(exposure, -3), 3);
  const pin = place(parts.get("pin"));
  if (pin) {
    state.pin = { colour: "blend", like: state.like, srgb: state.srgb, spectrum: null, ...pin, ...path("pin-path") };
    if (known(parts.get("pin-like"))) Object.assign(state.pin, { colour: "like", like: parts.get("pin-like") });
    if (colour(parts.get("pin-srgb"))) Object.assign(state.pin, { colour: "picked", srgb: parts.get("pin-srgb") });
  }
  return Object.assign(state, path("path"));
}

/** States before and after the present one. */
export class History {
  constructor(state) {
    this.states = [structuredClone(state)];
    this.at = 0;
  }

  push(state) {
    if (JSON.stringify(state) === JSON.stringify(this.states[this.at])) return;
    this.states.splice(this.at + 1);
    this.states.push(structuredClone(state));
    if (this.states.length > 200) this.states.shift();
    this.at = this.states.length - 1;
  }

  /** Let the present state differ without a step of its own. */
  amend(changes) {
    Object.assign(this.states[this.at], structuredClone(changes));
  }

  move(by) {
    this.at = Math.min(Math.max(this.at + by, 0), this.states.length - 1);
    return structuredClone(this.states[this.at]);
  }

  can(by) {
    return this.at + by >= 0 && this.at + by < this.states.length;
  }
}
