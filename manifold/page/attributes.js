// Sliders of what people think in: gloss, lightness, chroma and hue; methods of the page.

import { lookOf } from "./state.js";
import { fromLch, hexOf, labOfFactor, toLch, wordsFor } from "./colour.js";

const LCH = ["lightness", "chroma", "hue"];
const TURNS = 4; // of the search for a gloss: that of blended colours is not that of the chosen ones

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
    this.byId("gloss").addEventListener("input", (event) => this.setGloss(10 ** Number(event.target.value)));
    this.byId("gloss").addEventListener("change", () => {
      this.glossFrom = null;
      this.commit();
    });
  },

  /** Go to the place nearest to where the slider was taken that has a gloss, in the colour that was shown there. */
  setGloss(wanted) {
    const { colour } = this.state, keepsColour = colour === "blend" ? { colour: "lch", lch: this.attributesShown.lch } : {};
    this.glossFrom ??= { ...lookOf(this.state), ...keepsColour };
    let { x } = this.glossFrom, aim = wanted;
    for (let turn = 0; turn < TURNS; turn++) {
      x = this.map.clamped(this.materials.placeOfGloss(this.glossFrom.x, aim));
      const reached = this.predicted({ ...this.glossFrom, x }).gloss();
      if (Math.abs(Math.log(reached / wanted)) < 0.02) break;
      aim *= wanted / reached;
    }
    this.glossWanted = wanted;
    this.change({ ...this.glossFrom, x, at: undefined, path: null }, false);
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

  /** Lightness, chroma, hue and gloss of what is shown, while their tab is. */
  showAttributes() {
    if (this.tab !== "colour") return;
    const { state, prediction, data } = this;
    const found = toLch(labOfFactor(prediction.factor(), data.toSrgb.D65)), gloss = prediction.gloss();
    const asked = state.colour === "lch" ? state.lch : found;
    this.attributesShown = { lch: asked, gloss };
    const show = (name, value, text) => {
      if (this.byId(name) !== this.root.activeElement || Math.abs(this.byId(name).value - value) > 1) this.byId(name).value = value;
      this.byId(`${name}-value`).textContent = text;
      this.byId(name).setAttribute("aria-valuetext", text);
    };
    LCH.forEach((name, k) => show(name, asked[k], `${asked[k].toFixed(0)}${name === "hue" ? "°" : ""}`));
    show("gloss", Math.log10(Math.max(gloss, 1e-3)), `${Number(gloss.toPrecision(2))} GU`);
    const missed = [];
    const apart = Math.hypot(...fromLch(asked).map((v, k) => v - fromLch(found)[k]));
    if (apart > 2) missed.push(`colour: L ${found[0].toFixed(0)}, C ${found[1].toFixed(0)}, h ${found[2].toFixed(0)}° reached`);
    if (this.glossFrom && Math.abs(Math.log(gloss / this.glossWanted)) > 0.05) {
      missed.push(`gloss: ${gloss.toPrecision(2)} reached, ${this.glossWanted.toPrecision(2)} requested`);
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
