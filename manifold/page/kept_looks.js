// Looks that are kept in the filmstrip, and the comparison of two; methods of the page.

import { PLAIN, squareIn } from "./ball.js";
import { fixed, percent } from "./elements.js";
import { isBetween, lookOf } from "./state.js";

const FRAME = 96; // pixels across a picture of the filmstrip

export const keptLooks = {
  listenToVariants() {
    this.pictures = new Map(); // of looks, by their text
    this.byId("keep").addEventListener("click", () => this.change({ variants: [...this.state.variants, lookOf(this.state)] }));
    this.byId("pin").addEventListener("click", () => this.change({ pin: lookOf(this.state) }));
    this.byId("unpin").addEventListener("click", () => this.change({ pin: null }));
    this.byId("leave-out").addEventListener("click", () => this.leaveOut());
    this.byId("pinned").addEventListener("change", (event) => {
      const k = this.data.names.indexOf(event.target.value);
      const at = { x: [...(this.data.X[k] ?? [])], at: this.data.names[k], colour: "blend", path: null };
      this.change({ pin: k >= 0 ? { ...lookOf(this.state), ...at } : null });
    });
    for (const input of this.radios("view")) {
      input.addEventListener("change", () => this.change({ view: input.value }));
    }
    this.byId("wipe").addEventListener("input", (event) => {
      this.state.wipe = Number(event.target.value);
      this.showWipe();
      this.drawBalls();
    });
    this.byId("wipe").addEventListener("change", () => this.commit());
  },

  /** Show the filmstrip, one button per look: a click shows it again. */
  showVariants() {
    const { variants: looks } = this.state, strip = this.byId("strip"), key = JSON.stringify(looks);
    if (this.shownVariants === key) return;
    this.shownVariants = key;
    strip.hidden = !looks.length;
    const hadFocus = strip.contains(this.root.activeElement);
    strip.replaceChildren(...looks.map((look, k) => {
      const item = document.createElement("li"), show = document.createElement("button"), remove = document.createElement("button");
      const name = document.createElement("span"), picture = this.pictureOf(look);
      name.textContent = this.describe(look);
      show.type = remove.type = "button";
      show.append(...(picture ? [picture] : []), name);
      show.addEventListener("click", () => this.change(structuredClone(look)));
      remove.textContent = "×";
      remove.setAttribute("aria-label", `Remove ${name.textContent}`);
      remove.addEventListener("click", () => this.change({ variants: looks.filter((_, other) => other !== k) }));
      item.append(show, remove);
      return item;
    }));
    if (hadFocus) (strip.querySelector("button") ?? this.byId("keep")).focus();
    this.byId("save-looks").disabled = !looks.length;
    this.byId("all-looks").disabled = !looks.length;
    this.byId("all-looks-label").textContent = `all ${looks.length || ""} kept looks`;
  },

  /** A ball as a canvas, drawn once per look; null without graphics. */
  pictureOf(look, predicted = this.predicted(look)) {
    const key = JSON.stringify(look);
    if (!this.pictures.has(key) && this.balls) {
      this.balls.setSurface(2, predicted, "D65", PLAIN);
      const picture = document.createElement("canvas");
      Object.assign(picture, { width: FRAME, height: FRAME });
      picture.getContext("2d").putImageData(this.balls.image(2, FRAME), 0, 0);
      this.pictures.set(key, picture);
    }
    return this.pictures.get(key) ?? null;
  },

  /** Pin the material that is shown, and show what the others predict at its place, in its colours. */
  leaveOut() {
    const { at } = this.state;
    const pin = { ...lookOf(this.state), colour: "blend", path: null, without: false };
    this.change({ pin, colour: "like", like: at, path: null, without: true });
  },

  /** The looks that commands are about: that on the page or, where asked for, all that are kept. */
  looks() {
    return this.byId("all-looks").checked && this.state.variants.length ? this.state.variants : [lookOf(this.state)];
  },

  /** The slider that wipes between what is pinned, on the left, and what is shown, and its line. */
  showWipe() {
    const { pin, view, wipe } = this.state, isWiped = Boolean(pin) && view === "wipe";
    for (const id of ["wipe", "wipe-line"]) this.byId(id).hidden = !isWiped;
    this.byId("leave-out").disabled = !this.state.at;
    for (const input of this.radios("view")) input.checked = input.value === view;
    if (!isWiped) return;
    const { clientWidth: width, clientHeight: height } = this.byId("ball"), side = squareIn(width, height, 1);
    this.byId("wipe").value = wipe;
    this.byId("wipe").setAttribute("aria-valuetext", `${percent(wipe)} ${this.describe(pin)}`);
    Object.assign(this.byId("wipe").style, { left: `${(width - side) / 2}px`, width: `${side}px` });
    this.byId("wipe-line").style.left = `${(width - side) / 2 + wipe * side}px`;
  },

  /** How much what is pinned and what is shown differ in the light of the picture, where that is what it shows. */
  showDifference() {
    const { pin, view } = this.state, isShown = Boolean(pin && this.balls) && view === "difference";
    this.byId("difference").hidden = !isShown;
    if (!isShown) return;
    const { mean, most } = this.balls.difference([1, 0], this.light);
    this.byId("difference-text").textContent = `CIEDE2000 in this light, 0 to 10 or more; mean ${mean.toFixed(1)}, largest ${most.toFixed(1)}; visible from 1`;
  },

  /** The name of a look. */
  describe(look) {
    const { x, at, colour, like, srgb, spectrum, guest, lch, path, without } = look;
    if (isBetween(look)) return `${percent(path.t)} of the way from ${path.from} to ${path.to}`;
    if (colour === "own") return this.guests[guest]?.name ?? "";
    const place = (at ?? x.map((v) => fixed(v, 2)).join(", ")) + (without ? " predicted by the others" : "");
    if (colour === "lch") return `${place}, L ${fixed(lch[0], 0)} C ${fixed(lch[1], 0)} h ${fixed(lch[2], 0)}°`;
    const named = { like: `like ${like}`, picked: srgb, file: this.spectra[spectrum]?.name }[colour];
    return named ? `${place}, ${named}` : place;
  },
};
