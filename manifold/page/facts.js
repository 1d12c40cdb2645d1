// Descriptions of the shown latent as text; methods of the page.

import { highlightValley, fieldAt } from "./numerics.js";
import { fixed, percent } from "./elements.js";
import { isBetween } from "./state.js";

const NEAREST = 6;
const SILENCE = 400; // ms without a change, after which screen readers announce the latent
const VALLEY = 0.1; // a measured highlight has none deeper than 8 %
const ANISOTROPIC = 0.01; // share of anisotropic materials
const RESIDUAL = 0.02, UNMEASURED = 0.01; // as in manifold/model/diagnostics.py

export const facts = {
  /** Expected error of a look in its colours, 0 of a material in its own; null where it is unknown. */
  error(look = this.state) {
    const { x, colour, guest, like, without } = look, { error, names } = this.data;
    if (without || isBetween(look)) return null;
    if (colour === "own") return this.guests[guest].expected?.ball ?? null;
    const material = this.materials.materialAt(x);
    if (material >= 0 && (colour === "blend" || (colour === "like" && like === names[material]))) return 0;
    return fieldAt(error, x);
  },

  /** Expected error of a material that is located at a look's place and whose colour is not given; null if the look's colour is chosen. */
  unknownError(look = this.state) {
    const { error } = this.data;
    return this.hasBlendedColour(look) ? fieldAt({ ...error, values: error.blended }, look.x) : null;
  },

  /** Whether colours are blended from the surrounding materials, and errors larger than of a known colour. */
  hasBlendedColour({ colour } = this.state) {
    return colour === "blend" && Boolean(this.data.error?.blended);
  },

  isUnsupported(x) {
    const { error } = this.data;
    return (fieldAt({ ...error, values: error.unsupported }, x) ?? 1) > 0.5;
  },

  diagnostics({ x, colour, guest, path } = this.state, prediction = this.prediction) {
    const { data } = this, found = colour === "own" ? [...this.guests[guest].diagnostics] : [];
    const isPlace = data.error && !isBetween({ colour, path });
    if (isPlace && prediction.u[this.materials.materialAt(x)] !== 1 && this.isUnsupported(x)) {
      found.push("not supported by the data; choose a latent nearer to the materials");
    }
    const isShown = prediction === this.prediction;
    const valley = Math.max(...(isShown ? this.slices : prediction.slices("D65")).map(highlightValley));
    if (valley > VALLEY) found.push(`dark hole or ring near the mirror direction: ${percent(valley)} deep`);
    if (prediction.residual > RESIDUAL) {
      found.push(`requested reflectance cannot be reached at this point of the map: error up to ${prediction.residual.toFixed(2)}`);
    }
    const most = Math.max(...(isShown ? this.reflectance : prediction.reflectance()));
    if (most > 1.05) found.push(`not energy-conserving: reflectance ${most.toFixed(2)}`);
    const anisotropic = prediction.u.reduce((sum, u, i) => sum + u * data.anisotropic[i], 0);
    if (anisotropic > ANISOTROPIC) {
      found.push("anisotropic: the page shows it for half vectors along x only; `manifold render` shows all");
    }
    const unmeasured = prediction.u.reduce((sum, u, i) => sum + u * data.unmeasured[i], 0);
    if (unmeasured > UNMEASURED) {
      found.push(`${(100 * unmeasured).toFixed(0)} % of the cells were not measured, but filled from neighbours`);
    }
    return found;
  },

  nearest() {
    const { data, state, prediction } = this;
    return data.names
      .map((name, k) => ({ name, k, weight: prediction.u[k],
        distance: Math.hypot(...data.X[k].map((v, q) => v - state.x[q])) }))
      .sort((a, b) => b.weight - a.weight || a.distance - b.distance).slice(0, NEAREST);
  },

  errorText(error) {
    if (error === 0) return "none, because a measured material lies there";
    const { unit } = this.data.error ?? {}, digits = unit?.startsWith("CIE") ? 1 : 2, unknown = this.unknownError();
    const other = unknown === null ? "" : `, of a material of this colour; ${unknown.toFixed(digits)} of one located here, its colour not given`;
    return `${error.toFixed(digits)} (${unit})${other}`;
  },

  showFacts() {
    const { data, state } = this, error = this.error();
    const beyond = state.without ? "none: predicted by the others; compare it with the measured material"
      : isBetween(state) ? "none: a step of a walk has no point on the map"
      : data.error ? "outside the map" : "not computed above three dimensions";
    this.byId("error-value").textContent = error === null ? beyond : this.errorText(error);
    const found = this.diagnostics();
    this.byId("diagnostics").replaceChildren(...(found.length ? found : ["none; writing a file also checks that it is reciprocal"]).map((text) => {
      const item = document.createElement("li");
      item.textContent = text;
      if (found.length) item.className = "warning";
      return item;
    }));
    const known = error === null || !data.error ? "" : error === 0 ? "a measured material" : `${data.error.what} ${this.errorText(error)}`;
    this.byId("summary").textContent = [known, ...found].filter((text) => text).join("; ");
    this.byId("summary").classList.toggle("warning", found.length > 0);
    const nearest = this.nearest();
    const rows = this.byId("nearest");
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
    this.byId("caption").textContent = this.describe(state);
    this.byId("pin-caption").textContent = state.pin ? this.describe(state.pin) : "";
    const place = `${this.describe(state)}. Nearest ${nearest[0].name}, ${percent(nearest[0].weight)}. `;
    this.labels = { map: `Map of ${data.names.length} materials. ${place}`, ball: `Ball of the material at ${place}` };
    this.showLabels();
    clearTimeout(this.announcing);
    this.announcing = setTimeout(() => this.announcePlace(`${place}${known && `${known}. `}${found.join(". ")}`), SILENCE);
  },

  /** The names of the canvases; not of the one that has the focus, which screen readers would read besides the announcement. */
  showLabels() {
    for (const [id, label] of Object.entries(this.labels)) {
      if (this.byId(id) !== this.root.activeElement) this.byId(id).setAttribute("aria-label", label);
    }
  },

  announcePlace(text) {
    if (text !== this.announced) this.announce(text); // not again where only the light has changed
    this.announced = text;
  },

  /** Announce a text to screen readers. */
  announce(text) {
    this.byId("live").textContent = text;
  },

  /** Enable and disable buttons; the focus of one that is disabled goes to another, else it would be lost. */
  enable(buttons) {
    const focused = this.root.activeElement;
    for (const [id, isEnabled] of Object.entries(buttons)) this.byId(id).disabled = !isEnabled;
    const other = { undo: "redo", redo: "undo", unpin: "pin" }[focused?.id];
    if (other && focused.disabled) this.byId(other).focus();
  },

  showControls() {
    const { state, history: past } = this;
    for (const name of ["light", "shape", "colour"]) {
      for (const input of this.radios(name)) input.checked = input.value === state[name];
    }
    for (const name of ["turn", "turnShape"]) {
      this.byId(name).value = state[name];
      this.byId(`${name}-value`).textContent = `${state[name]}°`;
      this.byId(name).setAttribute("aria-valuetext", `${state[name]}°`);
    }
    this.showAttributes();
    this.showVariants();
    this.showWipe();
    this.byId("turn").disabled = state.light === "lamp";
    this.byId("turnShape").disabled = state.shape === "ball";
    this.byId("like").value = state.like;
    this.byId("picked").value = state.srgb;
    this.byId("spectrum-name").textContent = this.spectrum?.name ?? "";
    this.byId("illuminant").value = state.illuminant;
    this.byId("exposure").value = state.exposure;
    this.byId("exposure-value").textContent = `${state.exposure > 0 ? "+" : ""}${state.exposure} EV`;
    this.byId("exposure").setAttribute("aria-valuetext", this.byId("exposure-value").textContent);
    this.byId("ball").classList.toggle("lamp", state.light === "lamp");
    this.enable({ undo: past.can(-1), redo: past.can(1), unpin: Boolean(state.pin) });
    this.byId("pinned").value = state.pin ? state.pin.at && state.pin.colour === "blend" ? state.pin.at : "\u0000pinned" : "";
    this.byId("pinned").options[1].hidden = this.byId("pinned").options[1].disabled = this.byId("pinned").value !== "\u0000pinned";
    if (state.path) {
      this.byId("walk-from").value = state.path.from;
      this.byId("walk-to").value = state.path.to;
    }
    this.byId("walk-t").value = state.path?.t ?? 0;
    this.byId("walk-value").textContent = state.path ? percent(state.path.t) : "off";
    this.byId("walk-t").setAttribute("aria-valuetext", this.byId("walk-value").textContent);
    for (const input of this.byId("coordinates").querySelectorAll("input")) {
      if (input !== this.root.activeElement || input.type === "range") input.value = fixed(state.x[input.dataset.q], 3);
    }
  },
};
