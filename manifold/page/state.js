// The state of the page as one object, its history, and its form as the fragment of a link.

import { SHAPES } from "./shapes.js";
import { reachOf, within } from "./numerics.js";

const VIEWS = ["wipe", "beside", "difference"]; // of what is pinned and what is shown

/** The state at the start: the first surface, if any; else the material nearest to the middle of the map. */
export function initialState(data) {
  const Q = data.X[0].length;
  const middle = Array.from({ length: Q }, (_, q) => data.X.reduce((s, row) => s + row[q], 0) / data.X.length);
  const away = (row) => Math.hypot(...row.map((v, q) => v - middle[q]));
  const start = data.X.reduce((best, row) => (away(row) < away(best) ? row : best));
  return {
    x: [...start], colour: "blend", guest: null, ...surfaceLook(0, data), like: data.names[0], srgb: "#c08040", spectrum: null, lch: null, path: null,
    without: false, // the material of the place, which others predict
    light: "studio", turn: 0, lamp: [-0.4, 0.5], shape: "ball", turnShape: 30, illuminant: "D65", exposure: 0, pin: null, view: "wipe", wipe: 0.5,
    variants: [],
  };
}

/** What shows a surface of the page, by its number; nothing if there is none. */
const surfaceLook = (guest, data) =>
  data.surfaces[guest] ? { x: [...data.surfaces[guest].latent], colour: "own", guest } : {};

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

/** What a look is made of: a place and its colours, whatever the light. */
export function lookOf({ x, at, colour, like, srgb, spectrum, guest, lch, path, without }) {
  return structuredClone({ x, at, colour, like, srgb, spectrum, guest, lch, path, without });
}

/** A state as the fragment of a link, without what is as at the start; of dropped files places alone. */
export function toFragment(state) {
  const parts = lookParts(state);
  if (state.light === "lamp") parts.set("lamp", written(state.lamp));
  else if (state.light !== "studio") parts.set("light", state.light);
  if (state.turn) parts.set("turn", state.turn);
  if (state.shape !== "ball") parts.set("shape", `${state.shape},${state.turnShape}`);
  if (state.illuminant !== "D65") parts.set("illuminant", state.illuminant);
  if (state.exposure) parts.set("exposure", state.exposure);
  if (state.pin) parts.set("pin", asText(state.pin));
  if (state.view !== "wipe") parts.set("view", state.view);
  for (const look of state.variants) parts.append("variant", asText(look));
  return parts.toString();
}

const written = (x) => x.map((v) => String(Number(v.toFixed(4)))).join(",");

function lookParts({ x, at, colour, like, srgb, guest, lch, path, without }) {
  const parts = new URLSearchParams({ x: at ?? written(x) });
  if (colour === "like") parts.set("like", like);
  if (colour === "picked") parts.set("srgb", srgb);
  if (colour === "lch") parts.set("lch", written(lch));
  if (colour === "own") parts.set("surface", guest); // beyond the surfaces of the page: what was dropped, which no link shows
  if (path) parts.set("path", JSON.stringify([path.from, path.to, path.t]));
  if (without) parts.set("without", "1");
  return parts;
}

/** A look inside a link: its parts, the first of which, x, goes without its name. */
const asText = (look) => lookParts(look).toString().slice("x=".length);

/** What a link says of a look: nothing that is not understood, and places within reach. */
function readLook(parts, data) {
  const known = (name) => data.names.includes(name), found = {};
  const [text, like, srgb] = ["x", "like", "srgb"].map((key) => parts.get(key));
  if (known(text)) {
    Object.assign(found, { at: text, x: [...data.X[data.names.indexOf(text)]], without: parts.has("without") });
  } else {
    const x = numbers(text, data.X[0].length);
    if (x) found.x = within(reachOf(data.X), x);
  }
  if (found.x) found.colour = "blend"; // whatever the page begins with
  if (parts.has("surface")) Object.assign(found, surfaceLook(Number(parts.get("surface")), data));
  if (known(like)) Object.assign(found, { colour: "like", like });
  if (/^#[0-9a-f]{6}$/i.test(srgb ?? "")) Object.assign(found, { colour: "picked", srgb });
  const lch = numbers(parts.get("lch"), 3);
  if (lch && lch[0] >= 0 && lch[0] <= 100 && lch[1] >= 0 && lch[1] <= 200) Object.assign(found, { colour: "lch", lch });
  try {
    const [from, to, t] = JSON.parse(parts.get("path"));
    if (known(from) && known(to) && Number.isFinite(t) && t >= 0 && t <= 1) {
      const [a, b] = [from, to].map((name) => data.X[data.names.indexOf(name)]);
      found.path = { from, to, t };
      // The place is that of the path, however x was rounded.
      if (t > 0 && t < 1) Object.assign(found, { x: a.map((v, q) => v + t * (b[q] - v)), at: undefined });
    }
  } catch { /* not a path */ }
  return found;
}

/** The state of a fragment; whatever is not understood stays as at the start. */
export function fromFragment(fragment, data) {
  const state = initialState(data), parts = new URLSearchParams(fragment.replace(/^#/, ""));
  const nested = (text) => {
    const look = readLook(new URLSearchParams(`x=${text}`), data);
    return look.x ? [{ ...lookOf(initialState(data)), ...look }] : [];
  };
  Object.assign(state, readLook(parts, data));
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
  [state.pin] = [...nested(parts.get("pin") ?? ""), null];
  if (VIEWS.includes(parts.get("view"))) state.view = parts.get("view");
  state.variants = parts.getAll("variant").flatMap(nested);
  return state;
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
