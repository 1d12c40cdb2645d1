// The page: controls to state, state to pictures.

import { Materials } from "./numerics.js";
import { BallRenderer } from "./ball.js";
import { MapView } from "./map.js";
import { drawReflectance, drawSlices } from "./plots.js";
import { History, fromFragment, isBetween, lookOf, toFragment } from "./state.js";

import { controls } from "./controls.js";
import { documents } from "./documents.js";
import { facts } from "./facts.js";
import { attributes } from "./attributes.js";
import { decodeSrgb, fromLch } from "./colour.js";
import { guests } from "./guests.js";
import { makeTabs } from "./tabs.js";
import { keptLooks } from "./kept_looks.js";

const MOVING_HEIGHT = 320; // pixels in height of a ball that moves
const REST = 600; // ms without a change, after which the ball is lit more finely
const LOST = "The graphics were lost, so balls are not drawn until the browser restores them; everything else works.";
const THEMES = {
  light: { name: "light", certain: [253, 253, 251], uncertain: [191, 192, 189], ink: "#1d1f21", panel: "#ffffff",
    rule: "#b9b9b4", soft: "#5d6166", hatch: "#8f9296", point: "#0b62a8", pin: "#c2187a" },
  dark: { name: "dark", certain: [52, 56, 61], uncertain: [23, 24, 26], ink: "#e9e9e6", panel: "#202225",
    rule: "#55585e", soft: "#a5a9ae", hatch: "#5d6168", point: "#6db8f2", pin: "#ff7cc0" },
};

export class Explorer {
  /**
   * root: the document, or a shadow root, that holds the page's elements; element: the one that has the theme; link: where
   * the state is kept, {read, write, listen, address}.
   */
  constructor(data, materials, { root, element, link }) {
    this.data = data;
    this.materials = materials;
    Object.assign(this, { root, element, link });
    this.state = fromFragment(link.read(), data);
    this.history = new History(this.state);
    this.map = new MapView(this.byId("map"), data);
    this.spectra = []; // dropped ones; the state has the index of the one in use
    this.guests = data.surfaces.map(({ name, latent, expected, apart }, surface) => ( // and dropped materials, likewise
      { name, x: latent, expected: { ball: expected }, apart, surface, diagnostics: [] }));
    this.rest = REST;
    this.hover = -1;
    this.pinned = { key: null, prediction: null };
    this.shown = {}; // what the picture was last drawn of
    this.balls = BallRenderer.create(this.byId("ball"), materials);
    if (!this.balls) this.problem(`${this.missingGraphics()}, so balls are not drawn; everything else works.`);
    data.names.forEach((_, k) => this.map.showMaterial(k, materials.thumbnail(k)));
    this.pendingThumbnails = data.names.map((_, k) => k);
    this.extent = Math.max(...[0, 1].map((q) => this.map.high[q] - this.map.low[q]));
  }

  /** Why no balls can be drawn. */
  missingGraphics() {
    const hasWebGL = document.createElement("canvas").getContext("webgl2") !== null;
    return hasWebGL ? "This browser's WebGL2 cannot hold these materials" : "This browser has no WebGL2, or it is switched off";
  }

  start() {
    const { data } = this;
    this.byId("library").textContent = `${data.library}, ${data.names.length} materials` +
      (data.others.X.length ? `, blended; ${data.others.X.length} others are points here, and part of predict` : "");
    this.fillControls();
    this.listen();
    this.showTab = makeTabs(this.root.querySelector("[role=tablist]"), (id) => this.byId(id), (id) => this.tabShown(id));
    this.setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
    this.refresh();
    if (this.guests.length) this.showGuests();
    this.nextThumbnail();
  }

  /** The WebGL context was lost, as after a driver's reset; the browser restores it if the default is prevented. */
  loseBalls(event) {
    event.preventDefault();
    this.balls = null;
    this.problem(LOST);
  }

  restoreBalls() {
    this.balls = BallRenderer.create(this.byId("ball"), this.materials);
    this.pinned.key = this.shown.look = null;
    if (this.byId("problem-text").textContent === LOST) this.problem("");
    this.refresh();
    this.nextThumbnail();
  }

  get spectrum() {
    return this.spectra[this.state.spectrum] ?? null;
  }

  problem(text) {
    this.byId("problem-text").textContent = text;
    this.byId("problem").hidden = !text;
  }

  // -- state -------------------------------------------------------------------------------------------------

  /** Change the state; `done` where it is worth an undo. */
  change(changes, done = true) {
    if ("x" in changes && !("path" in changes)) changes.path = null;
    if ("x" in changes && !("colour" in changes) && this.state.colour === "own") changes.colour = "blend";
    if (("x" in changes || changes.path) && !("without" in changes)) changes.without = false;
    if ("x" in changes && !("at" in changes)) changes.at = this.data.names[this.materials.materialAt(changes.x)];
    Object.assign(this.state, changes);
    if (done) this.commit();
    else this.request();
  }

  commit() {
    this.history.push(this.state);
    this.link.write(toFragment(this.state), this);
    this.request();
  }

  byId(id) {
    return this.root.getElementById(id);
  }

  radios(name) {
    return [...this.root.querySelectorAll(`input[name="${name}"]`)];
  }

  restore(state) {
    this.state = state;
    this.link.write(toFragment(state), this);
    this.request();
  }

  /** The page as without a link. */
  reset() {
    this.history = new History(fromFragment("", this.data));
    this.restore(fromFragment("", this.data));
  }

  goTo(k, path = null) {
    if (k >= this.data.names.length) return this.showGuest(this.map.guests[k - this.data.names.length]);
    this.map.keepInView(this.data.X[k]);
    this.change({ x: [...this.data.X[k]], at: this.data.names[k], path });
  }

  request() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame(() => {
      this.requested = false;
      this.refresh();
    });
  }

  /** Reflectance at the nodes for a choice of colour; null blends materials whole. */
  requestedReflectance({ colour, like, srgb, spectrum }) {
    const { data } = this;
    if (colour === "like") return data.reflectances[data.names.indexOf(like)];
    if (colour === "file") return this.spectra[spectrum].reflectance;
    if (colour !== "picked") return null;
    const linear = [1, 3, 5].map((k) => decodeSrgb(parseInt(srgb.slice(k, k + 2), 16) / 255));
    return data.fromSrgb[0].map((_, j) =>
      Math.min(Math.max(linear.reduce((sum, v, c) => sum + v * data.fromSrgb[c][j], 0), 0), 1));
  }

  /** The prediction of a state or pin: a step of a walk, unless a colour is chosen. */
  predicted(state) {
    const { materials } = this, without = state.without ? materials.materialAt(state.x) : -1;
    if (state.colour === "own") {
      const guest = this.guests[state.guest];
      return guest.surface === undefined ? materials.predictIn(state.x, guest) : materials.surfaces[guest.surface];
    }
    if (state.colour === "lch") return materials.predictTinted(state.x, fromLch(state.lch), without);
    return isBetween(state) ? materials.between(state.path) : materials.predict(state.x, this.requestedReflectance(state), without);
  }

  // -- pictures ----------------------------------------------------------------------------------------------

  refresh() {
    const { state } = this, look = JSON.stringify([lookOf(state), state.illuminant]);
    const sky = JSON.stringify(this.sky), turned = JSON.stringify([state.shape, state.turnShape]);
    if (look !== this.shown.look) {
      this.prediction = this.predicted(state);
      this.slices = this.prediction.slices(state.illuminant);
      this.reflectance = this.prediction.reflectance();
    }
    const isLit = look === this.shown.look && sky === this.shown.sky;
    if (!isLit) this.balls?.setSurface(0, this.prediction, state.illuminant, this.sky, look === this.shown.look);
    if (this.refreshPin() || !isLit || turned !== this.shown.turned) this.refineLater();
    this.shown = { look, sky, turned };
    this.drawBalls();
    this.drawMap();
    this.drawPlots();
    this.showFacts();
    this.showControls();
    this.element.dataset.ready ??= performance.now().toFixed(0);
  }

  refineLater() {
    clearTimeout(this.refining);
    this.element.dataset.refined = "false";
    this.refining = setTimeout(() => this.refineStep(this.refined()), this.rest);
  }

  /** Refines what is shown, a strip per step, so that the page answers meanwhile. */
  *refined() {
    for (const k of this.state.pin ? [0, 1] : [0]) yield* this.balls?.refining(k) ?? [];
  }

  refineStep(steps) {
    if (!steps.next().done) {
      this.refining = setTimeout(() => this.refineStep(steps));
      return;
    }
    this.element.dataset.refined = "true";
    this.drawBalls();
  }

  /** Predict what is pinned, where it has changed; whether it has. */
  refreshPin() {
    const { pin, illuminant } = this.state, look = JSON.stringify(pin);
    const key = pin ? JSON.stringify([pin, illuminant, this.sky]) : null;
    if (this.pinned.key === key) return false;
    const isKnown = pin && look === this.pinned.look;
    this.pinned = { key, look, prediction: isKnown ? this.pinned.prediction : pin ? this.predicted(pin) : null };
    if (pin && this.balls) this.balls.setSurface(1, this.pinned.prediction, illuminant, this.sky, isKnown);
    return pin !== null;
  }

  get light() {
    const { light, lamp, exposure, shape, turnShape } = this.state;
    const [x, y] = lamp, z = Math.sqrt(Math.max(1 - x * x - y * y, 0));
    return { lamp: light === "lamp" ? [x, y, z] : null, exposure: 2 ** exposure, shape, turnShape: (turnShape * Math.PI) / 180 };
  }

  /** The environment, by its index, and how far it is turned. */
  get sky() {
    const { light, turn } = this.state;
    const environment = Math.max(this.data.environments.findIndex(({ name }) => name === light), 0);
    return { environment, turn: (turn * Math.PI) / 180 };
  }

  /** Pictures beside each other. */
  get columns() {
    return this.state.pin && this.state.view === "beside" ? 2 : 1;
  }

  /** What dragging the picture turns: a ball looks the same from all sides. */
  get turned() {
    return this.state.shape === "ball" ? "turn" : "turnShape";
  }

  drawBalls() {
    if (!this.balls) return;
    const canvas = this.byId("ball"), ratio = Math.min(window.devicePixelRatio || 1, 2);
    const isMoving = this.element.dataset.refined === "false";
    const scale = isMoving ? Math.min(ratio, MOVING_HEIGHT / canvas.clientHeight) : ratio;
    const width = Math.round(canvas.clientWidth * scale), height = Math.round(canvas.clientHeight * scale);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const { pin, view, wipe } = this.state;
    if (pin && view === "difference") this.balls.drawDifference([1, 0], this.light);
    else this.balls.draw(pin ? [1, 0] : [0], this.light, pin && view === "wipe" ? wipe : null);
    this.showDifference();
  }

  /** A tab was chosen: its curves are drawn while they are seen. */
  tabShown(id) {
    this.tab = id;
    if (!this.prediction) return;
    this.drawPlots();
    this.showAttributes();
  }

  drawPlots() {
    if (this.tab !== "here") return;
    const { illuminant } = this.state, other = this.pinned.prediction;
    const compared = this.state.pin && this.describe(this.state.pin);
    drawSlices(this.byId("slices"), this.slices, other?.slices(illuminant), compared);
    drawReflectance(this.byId("spectrum"), this.data.wavelengths, this.reflectance, other?.reflectance(), compared);
    this.byId("slices-other").textContent = compared ? `; dashed: ${compared}` : "";
    const kind = this.data.wavelengths ? "dashed" : "bars on the right";
    this.byId("spectrum-other").textContent = compared ? `; ${kind}: ${compared}` : "";
  }

  /** Finer balls of the materials than the page came with, one per frame, after the first picture. */
  nextThumbnail() {
    requestAnimationFrame(() => this.balls && !this.balls.gl.isContextLost() && this.drawThumbnail());
  }

  drawThumbnail() {
    const k = this.pendingThumbnails.shift();
    if (k === undefined) {
      this.element.dataset.complete = "true";
      return;
    }
    this.map.showMaterial(k, this.pictureOf({ material: k }, this.materials.predict(this.data.X[k])));
    this.drawMap();
    this.nextThumbnail();
  }
}

Object.assign(Explorer.prototype, facts, controls, documents, guests, keptLooks, attributes);
