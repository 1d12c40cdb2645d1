// Links and saved files; methods of the page.

import { isBetween } from "./state.js";

export const documents = {
  async copyLink() {
    this.commit();
    try {
      await navigator.clipboard.writeText(this.link.address());
      this.announce("Link copied");
      this.byId("link").textContent = "Copied";
    } catch {
      this.byId("link").textContent = "See the address";
    }
    setTimeout(() => (this.byId("link").textContent = "Copy link"), 1500);
  },

  listenToDownloads() {
    const listen = (id, save) => this.byId(id).addEventListener("click", save);
    listen("save-picture", () => this.savePicture());
    listen("save-latent", () => this.save("latent.json", this.latentDocument(this.state, this.prediction)));
    listen("save-colours", () => this.save("colours.json", this.coloursDocument()));
    listen("save-looks", () => this.save("kept-looks.json", {
      library: this.data.library,
      looks: this.state.variants.map((look) => this.latentDocument(look, this.predicted(look))),
    }));
  },

  /** The picture as it would be at rest, as PNG. */
  savePicture() {
    for (const k of this.state.pin ? [0, 1] : [0]) this.balls?.refine(k);
    this.element.dataset.refined = "true";
    this.drawBalls();
    this.byId("ball").toBlob((blob) => this.download("ball.png", blob));
  },

  latentDocument(look, prediction) {
    const { data } = this, error = this.error(look);
    const weights = Object.fromEntries(data.names.flatMap((name, k) => (prediction.u[k] > 0 ? [[name, prediction.u[k]]] : [])));
    return {
      library: data.library, latent: isBetween(look) ? null : look.x, material: look.at ?? null, path: isBetween(look) ? look.path : null,
      colour: this.choice(look), weights, [data.error?.what ?? "uncertainty"]: error,
      unit: data.error?.unit ?? null, "its colour not given": error === 0 ? null : this.unknownError(look),
      diagnostics: this.diagnostics(look, prediction),
    };
  },

  coloursDocument() {
    const { state, data, prediction } = this;
    return {
      library: data.library, latent: isBetween(state) ? null : state.x, colour: this.choice(state), wavelengths_nm: data.wavelengths,
      reflectance: this.reflectance, colour_coordinates: prediction.coordinates,
    };
  },

  choice({ colour, like, srgb, spectrum, guest, lch }) {
    return {
      blend: null, like: { like }, picked: { srgb }, file: { reflectance: this.spectra[spectrum]?.name },
      lch: { lch }, own: { file: this.guests[guest]?.name },
    }[colour];
  },

  save(name, content) {
    this.download(name, new Blob([`${JSON.stringify(content, null, 2)}\n`], { type: "application/json" }));
  },

  download(name, blob) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  },
};
