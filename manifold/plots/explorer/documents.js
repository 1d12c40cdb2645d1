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

  latentDocument() {
    const { state, data, prediction } = this;
    const weights = Object.fromEntries(data.names.flatMap((name, k) => (prediction.u[k] > 0 ? [[name, prediction.u[k]]] : [])));
    const error = this.error();
    return {
      library: data.library, latent: state.x, material: state.at ?? null, path: isBetween(state) ? state.path : null,
      colour: this.choice(), weights,
      [data.error?.what ?? "uncertainty"]: error, diagnostics: this.diagnostics(),
    };
  },

  coloursDocument() {
    const { state, data, prediction } = this;
    return {
      library: data.library, latent: state.x, colour: this.choice(), wavelengths_nm: data.wavelengths,
      reflectance: this.reflectance, colour_coordinates: prediction.coordinates,
    };
  },

  choice() {
    const { colour, like, srgb } = this.state;
    return { blend: null, like: { like }, picked: { srgb }, file: { reflectance: this.spectrum?.name } }[colour];
  },

  save(name, content) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([`${JSON.stringify(content, null, 2)}\n`], { type: "application/json" }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  },
};
