// Sliders of what people think in: readings of meters such as gloss, lightness, chroma and hue; methods of the page.

import { lookOf } from "./state.js";
import { fromLch, hexOf, labOfFactor, toLch, wordsFor } from "./colour.js";

const LCH = ["lightness", "chroma", "hue"];
const TURNS = 4; // of the search for a reading: that of blended colours is not that of the chosen ones

export const attributes = {
  listenToAttributes() {
    LCH.forEach((name, k) => {
      this.byId(name).addEventListener("input", (event) => {
        const lch = [...this.attributesShown.lch];
        lch[k] = Number(event.target.value);
        this.change({ colour: "lch", lch, path: null }, false);
      });
      this.byId(name).addEventListener("change", () => this.commit());
    });
    for (const meter of this.materials.meters) {
      const slider = this.addSlider(meter);
      slider.addEventListener("input", () => this.setReading(meter, 10 ** Number(slider.value)));
      slider.addEventListener("change", () => {
        this.searchedFrom = null;
        this.commit();
      });
    }
  },

  /** A slider of a meter, in decades, above that of the lightness. */
  addSlider({ id, label, least, most }) {
    const slider = Object.assign(document.createElement("input"), { id, type: "range", min: least, max: most, step: 0.02 });
    const value = Object.assign(document.createElement("output"), { id: `${id}-value` });
    value.setAttribute("aria-live", "off");
    const row = Object.assign(document.createElement("label"), { className: "slider" });
    row.append(`${label} `, slider, " ", value);
    this.byId("lightness").parentElement.before(row);
    return slider;
  },

  /** Go to the place nearest to where the slider was taken that has a reading, in the colour that was shown there. */
  setReading(meter, wanted) {
    const { colour } = this.state, keepsColour = colour === "blend" ? { colour: "lch", lch: this.attributesShown.lch } : {};
    this.searchedFrom ??= { ...lookOf(this.state), ...keepsColour };
    let { x } = this.searchedFrom, aim = wanted;
    for (let turn = 0; turn < TURNS; turn++) {
      x = this.map.clamped(this.materials.placeOf(meter, this.searchedFrom.x, aim));
      const reached = this.predicted({ ...this.searchedFrom, x }).reading(meter);
      if (Math.abs(Math.log(reached / wanted)) < 0.02) break;
      aim *= wanted / reached;
    }
    this.wantedReading = { meter, wanted };
    this.change({ ...this.searchedFrom, x, at: undefined, path: null }, false);
  },

  /** Of every material what a search knows: its name, words for its gloss and colour, and a text that says them; made once. */
  searched() {
    this.searchWords ??= [...this.data.names, ...this.data.others.names].map((name, k) => {
      if (k >= this.data.names.length) return { name, words: name.toLowerCase(), text: name };
      const prediction = this.materials.predict(this.data.X[k]), gloss = prediction.gloss();
      const words = wordsFor(toLch(labOfFactor(prediction.factor(), this.data.toSrgb.D65)), gloss);
      return { name, words: [name.toLowerCase(), ...words].join(" "), text: `${name}: ${words.join(", ")}, ${Number(gloss.toPrecision(2))} GU` };
    });
    return this.searchWords;
  },

  /** Lightness, chroma, hue and readings of what is shown, while their tab is. */
  showAttributes() {
    if (this.tab !== "colour") return;
    const { state, prediction, data } = this;
    const found = toLch(labOfFactor(prediction.factor(), data.toSrgb.D65));
    const asked = state.colour === "lch" ? state.lch : found;
    this.attributesShown = { lch: asked };
    const show = (name, value, text) => {
      if (this.byId(name) !== this.root.activeElement || Math.abs(this.byId(name).value - value) > 1) this.byId(name).value = value;
      this.byId(`${name}-value`).textContent = text;
      this.byId(name).setAttribute("aria-valuetext", text);
    };
    LCH.forEach((name, k) => show(name, asked[k], `${asked[k].toFixed(0)}${name === "hue" ? "°" : ""}`));
    for (const meter of this.materials.meters) {
      const reading = prediction.reading(meter);
      show(meter.id, Math.log10(Math.max(reading, 1e-3)), `${Number(reading.toPrecision(2))} ${meter.unit}`);
    }
    const missed = [];
    const apart = Math.hypot(...fromLch(asked).map((v, k) => v - fromLch(found)[k]));
    if (apart > 2) missed.push(`colour: L ${found[0].toFixed(0)}, C ${found[1].toFixed(0)}, h ${found[2].toFixed(0)}° reached`);
    if (this.searchedFrom) {
      const { meter, wanted } = this.wantedReading, reading = prediction.reading(meter);
      if (Math.abs(Math.log(reading / wanted)) > 0.05) {
        missed.push(`${meter.id}: ${reading.toPrecision(2)} reached, ${wanted.toPrecision(2)} requested`);
      }
    }
    this.byId("attributes-missed").textContent = missed.join("; ");
  },

  /** A look's colour as commands take it, where it was set by attributes: {srgb} or {spectrum: rows of nm and reflectance}. */
  plainColour(look) {
    const reflectance = this.predicted(look).reflectance(), { wavelengths } = this.data;
    if (!wavelengths) return { srgb: hexOf(reflectance) };
    return { spectrum: wavelengths.map((nm, j) => [nm, Math.min(Math.max(reflectance[j], 0), 1)]) };
  },
};
