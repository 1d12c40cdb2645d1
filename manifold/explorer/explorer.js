// The page: controls to state, state to pictures.

import { Materials, deepestValley, fieldAt, interpolate, parseSpectrum } from "./numerics.js";
import { BallRenderer, COARSE } from "./ball.js";
import { MapView } from "./map.js";
import { drawReflectance, drawSlices } from "./plots.js";
import { History, fromFragment, toFragment } from "./state.js";
import { serve } from "./served.js";

const THUMBNAIL = 96;
const REST = 600; // ms without a change, after which the ball is lit more finely
const NEAREST = 6;
const VALLEY = 0.1; // a measured highlight has none deeper than 8 %
const MISSED = 0.02, UNMEASURED = 0.01; // as in manifold/model/diagnostics.py
const STEP = 0.01, LARGE = 0.05; // of the map's extent, per press of an arrow key
const THEMES = {
  light: { name: "light", sure: [253, 253, 251], unsure: [191, 192, 189], ink: "#1d1f21", panel: "#ffffff",
    rule: "#b9b9b4", point: "#0b62a8", pin: "#c2187a" },
  dark: { name: "dark", sure: [52, 56, 61], unsure: [23, 24, 26], ink: "#e9e9e6", panel: "#202225",
    rule: "#55585e", point: "#6db8f2", pin: "#ff7cc0" },
};

const byId = (id) => document.getElementById(id);
const radios = (name) => [...document.querySelectorAll(`input[name="${name}"]`)];
const fixed = (v, digits) => v.toFixed(digits).replace(/^-(?=[0.]*$)/, "");
const percent = (v) => `${(100 * v).toFixed(v < 0.1 ? 1 : 0)} %`;

class Explorer {
  constructor(data, materials) {
    this.data = data;
    this.materials = materials;
    this.state = fromFragment(location.hash, data);
    this.history = new History(this.state);
    this.map = new MapView(byId("map"), data);
    this.spectrum = null;
    this.hover = -1;
    this.pinned = { key: null, prediction: null };
    this.balls = BallRenderer.create(byId("ball"), data);
    if (!this.balls) this.problem("This browser has no WebGL2, so balls are not drawn; all else works.");
    this.extent = Math.max(...[0, 1].map((q) => this.map.high[q] - this.map.low[q]));
  }

  start() {
    const { data } = this;
    byId("library").textContent = `${data.library}, ${data.names.length} materials`;
    this.fillControls();
    this.listen();
    this.setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
    this.refresh();
    this.pendingThumbnails = data.names.map((_, k) => k);
    if (this.balls) requestAnimationFrame(() => this.nextThumbnail());
  }

  problem(text) {
    byId("problem").textContent = text;
    byId("problem").hidden = !text;
  }

  // -- state -------------------------------------------------------------------------------------------------

  /** Change the state; `done` where it is worth an undo. */
  change(changes, done = true) {
    if ("x" in changes && !("path" in changes)) changes.path = null;
    if ("x" in changes && !("at" in changes)) changes.at = undefined;
    Object.assign(this.state, changes);
    if (done) this.commit();
    this.request();
  }

  commit() {
    this.history.push(this.state);
    const fragment = `#${toFragment(this.state)}`;
    if (location.hash !== fragment) history.replaceState(null, "", fragment);
  }

  restore(state) {
    this.state = state;
    history.replaceState(null, "", `#${toFragment(state)}`);
    this.request();
  }

  /** As the page was without a link. */
  reset() {
    this.history = new History(fromFragment("", this.data));
    this.restore(fromFragment("", this.data));
  }

  goTo(k, path = null) {
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

  /** Reflectance at the nodes that a colour choice asks for; null blends materials whole. */
  asked({ colour, like, srgb }) {
    const { data } = this;
    if (colour === "like") return data.reflectances[data.names.indexOf(like)];
    if (colour === "file" && this.spectrum) return this.spectrum.reflectance;
    if (colour !== "picked") return null;
    const linear = [1, 3, 5].map((k) => {
      const v = parseInt(srgb.slice(k, k + 2), 16) / 255;
      return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
    });
    return data.fromSrgb[0].map((_, j) =>
      Math.min(Math.max(linear.reduce((sum, v, c) => sum + v * data.fromSrgb[c][j], 0), 0), 1));
  }

  // -- pictures ----------------------------------------------------------------------------------------------

  refresh() {
    const began = performance.now(), { state } = this;
    this.prediction = this.materials.predict(state.x, this.asked(state));
    this.refreshPin();
    if (this.balls) {
      this.balls.setSurface(0, this.prediction.gridTexture(state.illuminant));
      this.drawBalls();
      this.refineLater();
    }
    this.map.draw(state, { hover: this.hover, weights: this.prediction.u, theme: this.theme });
    this.drawPlots();
    this.showFacts();
    this.showControls();
    this.refreshTime = performance.now() - began;
    document.documentElement.dataset.ready ??= performance.now().toFixed(0);
  }

  refineLater() {
    clearTimeout(this.refining);
    document.documentElement.dataset.refined = "false";
    this.refining = setTimeout(() => {
      for (const k of this.state.pin ? [0, 1] : [0]) this.balls.refine(k);
      this.drawBalls();
      document.documentElement.dataset.refined = "true";
    }, REST);
  }

  refreshPin() {
    const { pin, illuminant } = this.state;
    const key = pin ? JSON.stringify([pin, illuminant]) : null;
    if (this.pinned.key === key) return;
    this.pinned = { key, prediction: pin ? this.materials.predict(pin.x, this.asked(pin)) : null };
    if (pin && this.balls) this.balls.setSurface(1, this.pinned.prediction.gridTexture(illuminant));
  }

  get light() {
    const { light, lamp, exposure } = this.state;
    const [x, y] = lamp, z = Math.sqrt(Math.max(1 - x * x - y * y, 0));
    return { lamp: light === "lamp" ? [x, y, z] : null, exposure: 2 ** exposure };
  }

  drawBalls() {
    if (!this.balls) return;
    const canvas = byId("ball"), ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.balls.draw(this.state.pin ? [0, 1] : [0], this.light);
  }

  drawPlots() {
    const { illuminant } = this.state, other = this.pinned.prediction;
    this.slices = this.prediction.slices(illuminant);
    drawSlices(byId("slices"), this.slices, other?.slices(illuminant));
    this.reflectance = this.prediction.reflectance();
    drawReflectance(byId("spectrum"), this.data.wavelengths, this.reflectance, other?.reflectance());
  }

  /** Balls of the materials, one per frame, after the first picture. */
  nextThumbnail() {
    const k = this.pendingThumbnails.shift();
    if (k === undefined) {
      document.documentElement.dataset.complete = "true";
      return;
    }
    const own = this.materials.predict(this.data.X[k]);
    this.balls.setSurface(2, own.gridTexture("D65"), COARSE);
    const image = document.createElement("canvas");
    Object.assign(image, { width: THUMBNAIL, height: THUMBNAIL });
    image.getContext("2d").putImageData(this.balls.image(2, THUMBNAIL), 0, 0);
    this.map.images[k] = image;
    this.map.draw(this.state, { hover: this.hover, weights: this.prediction.u, theme: this.theme });
    requestAnimationFrame(() => this.nextThumbnail());
  }

  // -- words -------------------------------------------------------------------------------------------------

  /** Error to expect, 0 at a material; null where it is not known. */
  error() {
    const isMaterial = this.materials.materialAt(this.state.x) >= 0;
    return isMaterial ? 0 : fieldAt(this.data.error, this.state.x);
  }

  isUnsupported() {
    const { error } = this.data;
    return (fieldAt({ ...error, values: error.unsupported }, this.state.x) ?? 1) > 0.5;
  }

  diagnostics() {
    const { data, prediction, state } = this, found = [];
    if (data.error && prediction.u[this.materials.materialAt(state.x)] !== 1 && this.isUnsupported()) {
      found.push("extrapolated: the data say little here; stay nearer to the materials");
    }
    const valley = Math.max(...this.slices.map(deepestValley));
    if (valley > VALLEY) found.push(`the highlight has a dark valley of ${percent(valley)}`);
    if (prediction.missed > MISSED) {
      found.push(`requested reflectance out of reach at this structure: missed by up to ${prediction.missed.toFixed(2)}`);
    }
    const most = Math.max(...this.reflectance);
    if (most > 1.05) found.push(`not energy-conserving: reflectance ${most.toFixed(2)}`);
    const unmeasured = prediction.u.reduce((sum, u, i) => sum + u * data.unmeasured[i], 0);
    if (unmeasured > UNMEASURED) {
      found.push(`${(100 * unmeasured).toFixed(0)} % of the cells were not measured, but filled from neighbours`);
    }
    return found;
  }

  nearest() {
    const { data, state, prediction } = this;
    return data.names
      .map((name, k) => ({ name, k, weight: prediction.u[k],
        distance: Math.hypot(...data.X[k].map((v, q) => v - state.x[q])) }))
      .sort((a, b) => b.weight - a.weight || a.distance - b.distance).slice(0, NEAREST);
  }

  errorInWords(error) {
    const { unit } = this.data.error ?? {};
    return error === 0 ? "none: a measured material" : `${error.toFixed(unit?.startsWith("CIE") ? 1 : 2)} (${unit})`;
  }

  showFacts() {
    const { data, state } = this, error = this.error();
    const beyond = data.error ? "beyond the map" : "not known";
    byId("error-value").textContent = error === null ? beyond : this.errorInWords(error);
    const found = this.diagnostics();
    byId("diagnostics").replaceChildren(...(found.length ? found : ["none"]).map((text) => {
      const item = document.createElement("li");
      item.textContent = text;
      if (found.length) item.className = "warning";
      return item;
    }));
    const nearest = this.nearest();
    const rows = byId("nearest");
    while (rows.children.length < nearest.length) {
      const row = document.createElement("tr"), button = document.createElement("button");
      row.append(...[0, 1, 2].map(() => document.createElement("td")));
      button.type = "button";
      button.addEventListener("click", () => this.goTo(Number(button.dataset.k)));
      row.firstChild.append(button);
      rows.append(row);
    }
    nearest.forEach(({ name, k, weight, distance }, at) => {
      const [cell, share, away] = rows.children[at].children;
      cell.firstChild.textContent = name;
      cell.firstChild.dataset.k = k;
      share.textContent = percent(weight);
      away.textContent = distance.toFixed(2);
    });
    byId("caption").textContent = this.words(state);
    byId("pin-caption").textContent = state.pin ? this.words(state.pin) : "";
    const place = `${this.words(state)}. Nearest ${nearest[0].name}, ${percent(nearest[0].weight)}. `;
    const known = error === null ? "" : `${data.error.what} ${error.toFixed(2)}. `;
    byId("map").setAttribute("aria-label", `Map of ${data.names.length} materials. ${place}`);
    byId("ball").setAttribute("aria-label", `Ball of the material at ${place}`);
    clearTimeout(this.saying);
    this.saying = setTimeout(() => (byId("live").textContent = `${place}${known}${found.join(". ")}`), 400);
  }

  words({ x, at, colour, like, srgb }) {
    const place = at ?? x.map((v) => fixed(v, 2)).join(", ");
    const named = { like: `like ${like}`, picked: srgb, file: this.spectrum?.name ?? "" }[colour];
    return named ? `${place}, ${named}` : place;
  }

  showControls() {
    const { state, history: past } = this;
    for (const input of radios("light")) input.checked = input.value === state.light;
    for (const input of radios("colour")) input.checked = input.value === state.colour;
    byId("like").value = state.like;
    byId("picked").value = state.srgb;
    byId("illuminant").value = state.illuminant;
    byId("exposure").value = state.exposure;
    byId("exposure-value").textContent = `${state.exposure > 0 ? "+" : ""}${state.exposure} EV`;
    byId("undo").disabled = !past.can(-1);
    byId("redo").disabled = !past.can(1);
    byId("unpin").disabled = !state.pin;
    byId("pinned").value = state.pin ? state.pin.at && state.pin.colour === "blend" ? state.pin.at : "\u0000pinned" : "";
    byId("pinned").options[1].hidden = byId("pinned").options[1].disabled = byId("pinned").value !== "\u0000pinned";
    if (state.path) {
      byId("path-from").value = state.path.from;
      byId("path-to").value = state.path.to;
      byId("path-t").value = state.path.t;
    }
    byId("path-value").textContent = state.path ? percent(state.path.t) : "off";
    for (const input of byId("coordinates").querySelectorAll("input")) {
      if (input !== document.activeElement || input.type === "range") input.value = fixed(state.x[input.dataset.q], 3);
    }
  }

  // -- controls ----------------------------------------------------------------------------------------------

  fillControls() {
    const { data } = this;
    const options = (select, names) => select.append(...names.map((name) => new Option(name, name)));
    for (const id of ["like", "path-from", "path-to"]) options(byId(id), data.names);
    byId("pinned").append(new Option("nothing", ""), new Option("the pinned place", "\u0000pinned"));
    options(byId("pinned"), data.names);
    byId("path-to").value = data.names[data.names.length - 1];
    options(byId("illuminant"), Object.keys(data.toSrgb));
    if (!data.wavelengths) {
      byId("illuminant").disabled = true;
      byId("illuminant").title = "the materials of this library carry no spectra";
    }
    const letters = ["x", "y", "z"];
    data.X[0].forEach((_, q) => {
      const label = document.createElement("label"), input = document.createElement("input");
      const values = data.X.map((row) => row[q]), room = 0.24 * (Math.max(...values) - Math.min(...values) || 1);
      label.textContent = letters[q] ?? `dimension ${q + 1}`;
      const make = (type) => Object.assign(type, { min: Math.min(...values) - room, max: Math.max(...values) + room });
      input.type = "number";
      input.step = "any";
      make(input).dataset.q = q;
      input.addEventListener("change", () => this.moveAxis(q, Number(input.value)));
      if (q >= 2) {
        const slider = document.createElement("input");
        slider.type = "range";
        slider.step = "0.005";
        make(slider).dataset.q = q;
        slider.setAttribute("aria-label", `${label.textContent}, slider`);
        slider.addEventListener("input", () => this.moveAxis(q, Number(slider.value), false));
        slider.addEventListener("change", () => this.commit());
        label.className = "slider";
        label.append(slider);
      }
      label.append(input);
      byId("coordinates").append(label);
    });
    const name = data.error ? data.error.what : "uncertainty";
    byId("error-name").textContent = name[0].toUpperCase() + name.slice(1);
    byId("legend-text").textContent = data.error
      ? `${data.error.what}: 0 to ${data.error.most} or more (${data.error.unit})` : "";
    byId("map-legend").hidden = !data.error;
  }

  moveAxis(q, value, done = true) {
    if (!Number.isFinite(value)) return;
    const x = [...this.state.x];
    x[q] = value;
    this.change({ x: this.map.clamped(x) }, done);
  }

  listen() {
    this.listenToMap();
    this.listenToBall();
    this.listenToColours();
    this.listenToComparison();
    this.listenToSearch();
    byId("undo").addEventListener("click", () => this.restore(this.history.move(-1)));
    byId("redo").addEventListener("click", () => this.restore(this.history.move(1)));
    byId("link").addEventListener("click", () => this.copyLink());
    byId("theme").addEventListener("click", () => this.setTheme(this.theme.name === "dark" ? "light" : "dark"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", (e) => this.setTheme(e.matches ? "dark" : "light"));
    byId("save-latent").addEventListener("click", () => this.save("latent.json", this.latentDocument()));
    byId("save-colours").addEventListener("click", () => this.save("colours.json", this.coloursDocument()));
    document.addEventListener("keydown", (event) => this.shortcut(event));
    window.addEventListener("hashchange", () => {
      if (location.hash !== `#${toFragment(this.state)}`) {
        this.state = fromFragment(location.hash, this.data);
        this.history.push(this.state);
        this.request();
      }
    });
    new ResizeObserver(() => this.request()).observe(byId("map"));
    new ResizeObserver(() => this.drawBalls()).observe(byId("ball"));
  }

  shortcut(event) {
    const isText = /^(text|search|number)$/.test(event.target.type ?? "");
    if ((event.ctrlKey || event.metaKey) && !isText) {
      const key = event.key.toLowerCase();
      const by = key === "z" && !event.shiftKey ? -1 : key === "y" || (key === "z" && event.shiftKey) ? 1 : 0;
      if (by) {
        event.preventDefault();
        this.restore(this.history.move(by));
      }
    } else if (event.key === "/" && !isText) {
      event.preventDefault();
      byId("search").focus();
    }
  }

  listenToMap() {
    const { map } = this, { canvas } = map;
    let isDragged = false, touched = -1, from = null;
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      canvas.setPointerCapture(event.pointerId);
      canvas.focus({ preventScroll: true });
      isDragged = true;
      touched = map.materialUnder(event);
      from = [event.clientX, event.clientY];
      if (touched < 0) this.change({ x: map.toPlace(event, this.state.x) }, false);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (isDragged && touched >= 0 && Math.hypot(event.clientX - from[0], event.clientY - from[1]) < 4) return;
      if (isDragged) {
        touched = -1;
        this.change({ x: map.toPlace(event, this.state.x) }, false);
      } else {
        const hover = map.materialUnder(event);
        if (hover !== this.hover) {
          this.hover = hover;
          this.drawMap();
        }
      }
    });
    const end = () => {
      if (!isDragged) return;
      isDragged = false;
      if (touched >= 0) this.goTo(touched); else this.commit();
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => {
      this.hover = -1;
      this.drawMap();
    });
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.deltaY) return;
      event.preventDefault();
      this.zoom(map.zoom * Math.exp(-event.deltaY / 400));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.mapKey(event));
    canvas.addEventListener("keyup", (event) => event.key.startsWith("Arrow") && this.commit());
    byId("zoom-in").addEventListener("click", () => this.zoom(map.zoom * 1.5));
    byId("zoom-out").addEventListener("click", () => this.zoom(map.zoom / 1.5));
  }

  drawMap() {
    this.map.draw(this.state, { hover: this.hover, weights: this.prediction.u, theme: this.theme });
  }

  zoom(to) {
    this.map.zoomTo(to < 1.05 ? 1 : to, this.state.x);
    this.drawMap();
  }

  mapKey(event) {
    const move = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [1, 1], ArrowDown: [1, -1],
      PageUp: [2, 1], PageDown: [2, -1] }[event.key];
    if (move && move[0] < this.state.x.length) {
      event.preventDefault();
      const [q, sign] = move, x = [...this.state.x];
      x[q] += (sign * this.extent * (event.shiftKey ? LARGE : STEP)) / this.map.zoom;
      this.map.keepInView(x);
      this.change({ x: this.map.clamped(x) }, q === 2);
    } else if (event.key === "Enter") {
      this.goTo(this.nearest()[0].k);
    } else if (event.key === "+" || event.key === "=") {
      this.zoom(this.map.zoom * 1.5);
    } else if (event.key === "-") {
      this.zoom(this.map.zoom / 1.5);
    }
  }

  listenToBall() {
    const canvas = byId("ball");
    const aim = (x, y) => {
      const r = Math.max(Math.hypot(x, y) / 0.97, 1);
      this.state.lamp = [x / r, y / r];
      this.drawBalls();
    };
    canvas.addEventListener("pointermove", (event) => {
      if (this.state.light !== "lamp") return;
      const box = canvas.getBoundingClientRect(), count = this.state.pin ? 2 : 1;
      const side = Math.min(box.height, box.width / count);
      const left = event.clientX - box.left - (box.width - side * count) / 2;
      const across = count === 2 && left > side ? left - side : left;
      aim((2 * across) / side - 1, 1 - (2 * (event.clientY - box.top - (box.height - side) / 2)) / side);
    });
    canvas.addEventListener("pointerleave", () => this.state.light === "lamp" && this.commit());
    canvas.addEventListener("keydown", (event) => {
      const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (!move) return;
      event.preventDefault();
      if (this.state.light !== "lamp") this.change({ light: "lamp" });
      aim(this.state.lamp[0] + 0.05 * move[0], this.state.lamp[1] + 0.05 * move[1]);
      this.commit();
    });
    for (const input of radios("light")) input.addEventListener("change", () => this.change({ light: input.value }));
    byId("illuminant").addEventListener("change", (event) => this.change({ illuminant: event.target.value }));
    byId("exposure").addEventListener("input", (event) => {
      this.state.exposure = Number(event.target.value);
      this.showControls();
      this.drawBalls();
    });
    byId("exposure").addEventListener("change", () => this.commit());
  }

  listenToColours() {
    for (const input of radios("colour")) {
      input.addEventListener("change", () => {
        if (input.value === "file" && !this.spectrum) {
          this.showControls();
          byId("spectrum-file").focus();
        } else {
          this.change({ colour: input.value });
        }
      });
    }
    byId("like").addEventListener("change", (event) => this.change({ colour: "like", like: event.target.value }));
    byId("picked").addEventListener("input", (event) => this.change({ colour: "picked", srgb: event.target.value }, false));
    byId("picked").addEventListener("change", () => this.commit());
    byId("spectrum-file").addEventListener("change", (event) => this.takeFile(event.target.files[0]));
    document.addEventListener("dragover", (event) => {
      event.preventDefault();
      document.body.classList.add("dropping");
    });
    document.addEventListener("dragleave", (event) => {
      if (!event.relatedTarget) document.body.classList.remove("dropping");
    });
    document.addEventListener("drop", (event) => {
      event.preventDefault();
      document.body.classList.remove("dropping");
      if (event.dataTransfer.files.length) this.takeFile(event.dataTransfer.files[0]);
    });
  }

  async takeFile(file) {
    if (!file) return;
    if (this.server && /\.bsdf$/i.test(file.name)) {
      this.server.locate(file);
      return;
    }
    try {
      if (file.size > 1e6) throw new Error("expected a text file of at most 1 MB");
      const { nm, values } = parseSpectrum(await file.text());
      this.spectrum = { name: file.name, rows: nm.map((v, k) => [v, values[k]]), reflectance: this.spectrumAtNodes(nm, values) };
      this.problem("");
      this.change({ colour: "file" });
    } catch (error) {
      this.problem(`${file.name}: ${error.message}`);
    }
  }

  spectrumAtNodes(nm, values) {
    const { wavelengths, fileSpectra } = this.data;
    if (wavelengths) return wavelengths.map((w) => interpolate(w, nm, values));
    const sampled = fileSpectra.wavelengths.map((w) => interpolate(w, nm, values));
    return [0, 1, 2].map((c) => {
      const linear = sampled.reduce((sum, v, k) => sum + v * fileSpectra.toSrgb[k][c], 0);
      return Math.min(Math.max(linear, 0), 1);
    });
  }

  listenToComparison() {
    byId("pin").addEventListener("click", () => {
      const { x, at, colour, like, srgb } = this.state;
      this.change({ pin: structuredClone({ x, at, colour, like, srgb }) });
    });
    byId("unpin").addEventListener("click", () => this.change({ pin: null }));
    byId("pinned").addEventListener("change", (event) => {
      const k = this.data.names.indexOf(event.target.value);
      const { like, srgb } = this.state;
      const x = k >= 0 ? [...this.data.X[k]] : null;
      this.change({ pin: x ? { x, at: this.data.names[k], colour: "blend", like, srgb } : null });
    });
    const travel = (done) => {
      const [from, to, t] = [byId("path-from").value, byId("path-to").value, Number(byId("path-t").value)];
      const [a, b] = [from, to].map((name) => this.data.X[this.data.names.indexOf(name)]);
      const at = t === 0 ? from : t === 1 ? to : undefined;
      this.change({ x: a.map((v, q) => (t === 1 ? b[q] : v + t * (b[q] - v))), at, path: { from, to, t } }, done);
    };
    byId("path-t").addEventListener("input", () => travel(false));
    byId("path-t").addEventListener("change", () => this.commit());
    byId("path-from").addEventListener("change", () => travel(true));
    byId("path-to").addEventListener("change", () => travel(true));
  }

  listenToSearch() {
    const input = byId("search"), list = byId("found");
    let found = [], at = 0;
    const close = () => {
      list.hidden = true;
      input.setAttribute("aria-expanded", "false");
      input.removeAttribute("aria-activedescendant");
    };
    const show = () => {
      const words = input.value.trim().toLowerCase().split(/\s+/);
      found = input.value.trim()
        ? this.data.names.flatMap((name, k) => (words.every((w) => name.toLowerCase().includes(w)) ? [k] : [])) : [];
      at = Math.min(at, Math.max(found.length - 1, 0));
      list.replaceChildren(...found.map((k, row) => {
        const item = document.createElement("li");
        item.id = `found-${row}`;
        item.setAttribute("role", "option");
        item.setAttribute("aria-selected", String(row === at));
        item.textContent = this.data.names[k];
        item.addEventListener("pointerdown", (event) => {
          event.preventDefault();
          choose(k);
        });
        return item;
      }));
      list.hidden = !found.length;
      input.setAttribute("aria-expanded", String(found.length > 0));
      if (found.length) input.setAttribute("aria-activedescendant", `found-${at}`);
      list.children[at]?.scrollIntoView({ block: "nearest" });
    };
    const choose = (k) => {
      input.value = "";
      close();
      this.goTo(k);
    };
    input.addEventListener("input", () => {
      at = 0;
      show();
    });
    input.addEventListener("blur", close);
    input.addEventListener("keydown", (event) => {
      const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
      if (by && found.length) {
        event.preventDefault();
        at = (at + by + found.length) % found.length;
        show();
      } else if (event.key === "Enter" && found.length) {
        choose(found[at]);
      } else if (event.key === "Escape") {
        close();
      }
    });
  }

  setTheme(name) {
    this.theme = THEMES[name];
    document.documentElement.dataset.theme = name;
    byId("theme").textContent = name === "dark" ? "Light" : "Dark";
    byId("theme").setAttribute("aria-pressed", String(name === "dark"));
    if (this.prediction) this.drawMap();
  }

  // -- leaving the page --------------------------------------------------------------------------------------

  async copyLink() {
    this.commit();
    try {
      await navigator.clipboard.writeText(location.href);
      byId("live").textContent = "Link copied";
      byId("link").textContent = "Copied";
    } catch {
      byId("link").textContent = "See the address";
    }
    setTimeout(() => (byId("link").textContent = "Copy link"), 1500);
  }

  latentDocument() {
    const { state, data, prediction } = this;
    const weights = Object.fromEntries(data.names.flatMap((name, k) => (prediction.u[k] > 0 ? [[name, prediction.u[k]]] : [])));
    const error = this.error();
    return {
      library: data.library, latent: state.x, material: state.at ?? null, colour: this.choice(), weights,
      [data.error?.what ?? "uncertainty"]: error, diagnostics: this.diagnostics(),
    };
  }

  coloursDocument() {
    const { state, data, prediction } = this;
    return {
      library: data.library, latent: state.x, colour: this.choice(), wavelengths_nm: data.wavelengths,
      reflectance: this.reflectance, colour_coordinates: prediction.coordinates,
    };
  }

  choice() {
    const { colour, like, srgb } = this.state;
    return { blend: null, like: { like }, picked: { srgb }, file: { reflectance: this.spectrum?.name } }[colour];
  }

  save(name, content) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([`${JSON.stringify(content, null, 2)}\n`], { type: "application/json" }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }
}

const data = JSON.parse(byId("data").textContent);
const explorer = new Explorer(data, await Materials.load(data));
explorer.server = serve(explorer, data.served);
explorer.start();
window.explorer = explorer; // for scripts and tests
