// What people think in: sliders of lightness, chroma and hue, and the gloss with the command that changes it; methods of the page.

import { fixed } from "./elements.js";
import { isBetween } from "./state.js";
import { fromLch, hexOf, labOfFactor, toLch, wordsFor } from "./colour.js";

const LCH = ["lightness", "chroma", "hue"];

/** A word of a command, in quotes where a shell would not take it as it is. */
const quoted = (word) => (/^[\w.,:+-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

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
    const found = toLch(labOfFactor(prediction.factor(), data.toSrgb.D65));
    const asked = state.colour === "lch" ? state.lch : found;
    this.attributesShown = { lch: asked };
    const show = (name, value, text) => {
      if (this.byId(name) !== this.root.activeElement || Math.abs(this.byId(name).value - value) > 1) this.byId(name).value = value;
      this.byId(`${name}-value`).textContent = text;
      this.byId(name).setAttribute("aria-valuetext", text);
    };
    LCH.forEach((name, k) => show(name, asked[k], `${asked[k].toFixed(0)}${name === "hue" ? "°" : ""}`));
    this.byId("gloss").textContent = `${Number(prediction.gloss().toPrecision(2))} GU`;
    const command = this.glossCommand(state);
    this.byId("gloss-command").replaceChildren(...command.split(" ").flatMap((word, k) => [
      ...(k ? [" "] : []), Object.assign(document.createElement("span"), { textContent: word })]));
    this.byId("gloss-note").hidden = !command;
    const apart = Math.hypot(...fromLch(asked).map((v, k) => v - fromLch(found)[k]));
    this.byId("attributes-missed").textContent = apart > 2
      ? `colour: L ${found[0].toFixed(0)}, C ${found[1].toFixed(0)}, h ${found[2].toFixed(0)}° reached` : "";
  },

  /** The command that changes the gloss of a look; empty if no command makes the look. */
  glossCommand(look) {
    const { x, at, colour, like, srgb, spectrum, lch, path, without } = look;
    if (without || colour === "own") return "";
    const place = isBetween(look) ? `${path.from}:${path.to}:${fixed(path.t, 3)}` : at ?? x.map((v) => fixed(v, 4)).join(",");
    const tint = {
      blend: () => [], like: () => ["--like", like], picked: () => ["--srgb", srgb],
      file: () => ["--reflectance", this.spectra[spectrum].name],
      lch: () => LCH.flatMap((name, k) => [`--${name}`, fixed(lch[k], 1)]),
    }[colour]();
    const words = ["manifold", "predict", place, ...tint].map(quoted).join(" ");
    return `${words} --gloss 60=VALUE -o edited_${this.data.wavelengths ? "spec" : "rgb"}.bsdf`;
  },

  /** A look's colour as commands take it, where it was set by attributes: {srgb} or {spectrum: rows of nm and reflectance}. */
  plainColour(look) {
    const reflectance = this.predicted(look).reflectance(), { wavelengths } = this.data;
    if (!wavelengths) return { srgb: hexOf(reflectance) };
    return { spectrum: wavelengths.map((nm, j) => [nm, Math.min(Math.max(reflectance[j], 0), 1)]) };
  },
};
