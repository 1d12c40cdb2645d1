// Controls to state, by mouse and by keyboard; methods of the page.

import { squareIn } from "./ball.js";
import { fixed } from "./elements.js";
import { interp, readReflectance } from "./numerics.js";
import { isPicture } from "./photo.js";
import { fromFragment, lampWithin, toFragment } from "./state.js";

const DEGREES_ACROSS = 270; // by which a drag across the whole picture turns it
const STEP = 0.01, LARGE = 0.05; // of the map's extent, per press of an arrow key
const SYNONYMS = { matte: "matt", shiny: "glossy", "semi-gloss": "satin", gray: "grey" };
const MOST_FOUND = 50; // names in the list of a search

export const controls = {
  fillControls() {
    const { data } = this;
    const options = (select, names) => select.append(...names.map((name) => new Option(name, name)));
    for (const id of ["like", "walk-from", "walk-to"]) options(this.byId(id), data.names);
    this.byId("pinned").append(new Option("nothing", ""), new Option("the pinned latent", "\u0000pinned"));
    options(this.byId("pinned"), data.names);
    this.byId("walk-to").value = data.names[data.names.length - 1];
    options(this.byId("illuminant"), Object.keys(data.toSrgb));
    if (!data.wavelengths) {
      this.byId("illuminant").disabled = true;
      this.byId("illuminant-reason").hidden = false;
      this.byId("illuminant").setAttribute("aria-describedby", "illuminant-reason");
    }
    const letters = ["x", "y", "z"];
    data.X[0].forEach((_, q) => {
      const label = document.createElement("label"), input = document.createElement("input");
      const [min, max] = this.map.reach[q];
      label.textContent = letters[q] ?? `dimension ${q + 1}`;
      const make = (type) => Object.assign(type, { min, max });
      input.type = "number";
      input.step = "any";
      make(input).dataset.q = q;
      input.addEventListener("change", () => {
        this.moveAxis(q, input.valueAsNumber);
        input.value = fixed(this.state.x[q], 3); // within reach, and as it was where no number was written
      });
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
      this.byId("coordinates").append(label);
    });
    const name = data.error ? data.error.what : "uncertainty";
    this.byId("error-name").textContent = name[0].toUpperCase() + name.slice(1);
    this.byId("legend-text").textContent = data.error
      ? `${data.error.what}${data.error.blended ? " in a given colour" : ""}: 0 to ${data.error.most} or more (${data.error.unit})` : "";
    this.byId("map-legend").hidden = this.byId("hatch-legend").hidden = !data.error;
    this.byId("coherence-name").hidden = this.byId("coherence").hidden = !data.coherence;
    this.byId("coherence").textContent = data.coherence
      ? `halfway between similar materials, detour ${fixed(data.coherence.detour, 2)}; 90th percentile ${fixed(data.coherence.detour_p90, 2)} (1: between both)` : "";
    this.byId("depth-help").hidden = data.X[0].length < 3;
  },

  moveAxis(q, value, done = true) {
    if (!Number.isFinite(value)) return;
    const x = [...this.state.x];
    x[q] = value;
    this.change({ x: this.map.clamped(x) }, done);
  },

  listen() {
    this.listenToMap();
    this.listenToBall();
    this.listenToColours();
    this.listenToPath();
    this.listenToVariants();
    this.listenToAttributes();
    this.listenToSearch();
    this.byId("undo").addEventListener("click", () => this.restore(this.history.move(-1)));
    this.byId("redo").addEventListener("click", () => this.restore(this.history.move(1)));
    this.byId("link").addEventListener("click", () => this.copyLink());
    this.byId("theme").addEventListener("click", () => this.setTheme(this.theme.name === "dark" ? "light" : "dark"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", (e) => this.setTheme(e.matches ? "dark" : "light"));
    this.listenToDownloads();
    this.byId("problem-close").addEventListener("click", () => {
      this.problem("");
      this.byId("map").focus({ preventScroll: true }); // what had the focus is hidden
    });
    this.root.addEventListener("keydown", (event) => this.shortcut(event));
    this.link.listen(() => {
      if (this.link.read() !== toFragment(this.state)) {
        this.state = fromFragment(this.link.read(), this.data);
        this.history.push(this.state);
        this.request();
      }
    });
    new ResizeObserver(() => this.request()).observe(this.byId("map"));
    new ResizeObserver(() => this.drawBalls()).observe(this.byId("ball"));
  },

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
      this.byId("search").focus();
    }
  },

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
    canvas.addEventListener("blur", () => this.showLabels());
    this.byId("zoom-in").addEventListener("click", () => this.zoom(map.zoom * 1.5));
    this.byId("zoom-out").addEventListener("click", () => this.zoom(map.zoom / 1.5));
  },

  drawMap() {
    this.map.draw(this.state, { hover: this.hover, weights: this.prediction.u, theme: this.theme });
  },

  zoom(to) {
    this.map.zoomTo(to < 1.05 ? 1 : to, this.state.x);
    this.drawMap();
  },

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
  },

  listenToBall() {
    const canvas = this.byId("ball");
    const aim = (x, y) => {
      this.state.lamp = lampWithin([x, y]);
      this.drawBalls();
    };
    // Where the lamp was is kept, but to undo is not to follow the pointer back.
    const keepLamp = () => {
      this.history.amend({ lamp: this.state.lamp });
      this.link.write(toFragment(this.state), this);
    };
    canvas.addEventListener("blur", () => this.showLabels());
    canvas.addEventListener("webglcontextlost", (event) => this.loseBalls(event));
    canvas.addEventListener("webglcontextrestored", () => this.restoreBalls());
    let from = null; // where a drag began, and how far things were turned then
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || (this.state.light === "lamp" && this.turned === "turn")) return;
      canvas.setPointerCapture(event.pointerId);
      from = [event.clientX, this.state[this.turned]];
    });
    canvas.addEventListener("pointermove", (event) => {
      if (from) {
        this.turnTo(this.turned, from[1] + ((event.clientX - from[0]) / canvas.clientWidth) * DEGREES_ACROSS, false);
      } else if (this.state.light === "lamp") {
        const box = canvas.getBoundingClientRect(), count = this.columns;
        const side = squareIn(box.width, box.height, count), column = box.width / count;
        const across = ((event.clientX - box.left) % column) - (column - side) / 2;
        aim((2 * across) / side - 1, 1 - (2 * (event.clientY - box.top - (box.height - side) / 2)) / side);
      }
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, () => {
        if (from) this.commit();
        from = null;
      });
    }
    canvas.addEventListener("pointerleave", () => this.state.light === "lamp" && keepLamp());
    canvas.addEventListener("keydown", (event) => {
      const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (!move) return;
      event.preventDefault();
      if (this.state.light === "lamp") {
        aim(this.state.lamp[0] + 0.05 * move[0], this.state.lamp[1] + 0.05 * move[1]);
        keepLamp();
      } else {
        this.turnTo(this.turned, this.state[this.turned] + 5 * move[0], false);
      }
    });
    canvas.addEventListener("keyup", (event) => event.key.startsWith("Arrow") && this.commit());
    for (const name of ["light", "shape"]) {
      for (const input of this.radios(name)) input.addEventListener("change", () => this.change({ [name]: input.value }));
    }
    for (const name of ["turn", "turnShape"]) {
      this.byId(name).addEventListener("input", (event) => this.turnTo(name, Number(event.target.value), false));
      this.byId(name).addEventListener("change", () => this.commit());
    }
    this.byId("illuminant").addEventListener("change", (event) => this.change({ illuminant: event.target.value }));
    this.byId("exposure").addEventListener("input", (event) => {
      this.state.exposure = Number(event.target.value);
      this.showControls();
      this.drawBalls();
    });
    this.byId("exposure").addEventListener("change", () => this.commit());
  },

  turnTo(name, degrees, done) {
    this.change({ [name]: Math.round(((((degrees + 180) % 360) + 360) % 360) - 180) }, done);
  },

  listenToColours() {
    for (const input of this.radios("colour")) {
      input.addEventListener("change", () => {
        const spectrum = this.state.spectrum ?? this.spectra.length - 1;
        if (input.value === "lch") {
          this.change({ colour: "lch", lch: this.attributesShown.lch, path: null });
        } else if (input.value !== "file") {
          this.change({ colour: input.value });
        } else if (spectrum >= 0) {
          this.change({ colour: "file", spectrum });
        } else {
          this.showControls();
          this.byId("spectrum-file").focus();
        }
      });
    }
    this.byId("like").addEventListener("change", (event) => this.change({ colour: "like", like: event.target.value }));
    this.byId("picked").addEventListener("input", (event) => this.change({ colour: "picked", srgb: event.target.value }, false));
    this.byId("picked").addEventListener("change", () => this.commit());
    this.byId("spectrum-file").addEventListener("change", (event) => {
      const [file] = event.target.files;
      event.target.value = ""; // so that the same file can be chosen again
      this.takeSpectrum(file);
    });
    this.root.addEventListener("dragover", (event) => {
      event.preventDefault();
      this.element.classList.add("dropping");
    });
    this.root.addEventListener("dragleave", (event) => {
      if (!event.relatedTarget) this.element.classList.remove("dropping");
    });
    this.root.addEventListener("drop", (event) => {
      event.preventDefault();
      this.element.classList.remove("dropping");
      this.takeDropped([...event.dataTransfer.files]);
    });
  },

  async takeDropped(files) {
    for (const file of files) {
      try {
        if (await this.server?.take(file)) continue;
      } catch (error) {
        this.problem(`${file.name}: ${error.message}`); // a folder, or a file that is gone
        continue;
      }
      if (isPicture(file)) this.showTab("photo"); // which says what finds it
      else await this.takeSpectrum(file);
    }
  },

  async takeSpectrum(file) {
    if (!file) return;
    try {
      if (file.size > 1e6) throw new Error("expected a text file of at most 1 MB");
      const { nm, values } = readReflectance(await file.text());
      const rows = nm.map((v, k) => [v, values[k]]), reflectance = this.spectrumAtNodes(nm, values);
      const spectrum = this.spectra.push({ name: file.name, rows, reflectance }) - 1;
      this.problem("");
      this.change({ colour: "file", spectrum });
    } catch (error) {
      this.problem(`${file.name}: ${error.message}`);
    }
  },

  spectrumAtNodes(nm, values) {
    const { wavelengths, fileSpectra } = this.data;
    if (wavelengths) return wavelengths.map((w) => interp(w, nm, values));
    const sampled = fileSpectra.wavelengths.map((w) => interp(w, nm, values));
    return [0, 1, 2].map((c) => {
      const linear = sampled.reduce((sum, v, k) => sum + v * fileSpectra.toSrgb[k][c], 0);
      return Math.min(Math.max(linear, 0), 1);
    });
  },

  listenToPath() {
    const travel = (done) => {
      const [from, to, t] = [this.byId("walk-from").value, this.byId("walk-to").value, Number(this.byId("walk-t").value)];
      const [a, b] = [from, to].map((name) => this.data.X[this.data.names.indexOf(name)]);
      const at = t === 0 ? from : t === 1 ? to : undefined;
      this.change({ x: a.map((v, q) => (t === 1 ? b[q] : v + t * (b[q] - v))), at, path: { from, to, t } }, done);
    };
    this.byId("walk-t").addEventListener("input", () => travel(false));
    this.byId("walk-t").addEventListener("change", () => this.commit());
    this.byId("walk-from").addEventListener("change", () => travel(true));
    this.byId("walk-to").addEventListener("change", () => travel(true));
  },

  listenToSearch() {
    const input = this.byId("search"), list = this.byId("found"), { names, others } = this.data;
    let found = [], at = 0;
    const close = () => {
      list.hidden = true;
      input.setAttribute("aria-expanded", "false");
      input.removeAttribute("aria-activedescendant");
    };
    const show = () => {
      const words = input.value.trim().toLowerCase().split(/\s+/);
      const isOf = (one) => words.every((word) => one.words.includes(word) || one.words.includes(SYNONYMS[word] ?? word));
      found = input.value.trim()
        ? this.searched().flatMap((one, k) => (isOf(one) ? [k] : [])) : [];
      found = found.slice(0, MOST_FOUND);
      at = Math.min(at, Math.max(found.length - 1, 0));
      list.replaceChildren(...found.map((k, row) => {
        const item = document.createElement("li");
        item.id = `found-${row}`;
        item.setAttribute("role", "option");
        item.setAttribute("aria-selected", String(row === at));
        item.textContent = this.searched()[k].text;
        item.addEventListener("pointerdown", (event) => event.preventDefault()); // the focus stays
        item.addEventListener("click", () => choose(k)); // a finger may scroll the list; screen readers only click
        return item;
      }));
      if (!found.length) {
        const none = document.createElement("li");
        none.setAttribute("role", "option");
        none.setAttribute("aria-disabled", "true");
        none.textContent = "no material has such a name, gloss or colour";
        list.append(none);
        if (input.value.trim()) this.announce(none.textContent);
      }
      list.hidden = !input.value.trim();
      input.setAttribute("aria-expanded", String(!list.hidden));
      input.removeAttribute("aria-activedescendant");
      if (found.length) input.setAttribute("aria-activedescendant", `found-${at}`);
      list.children[at].scrollIntoView({ block: "nearest" });
    };
    const choose = (k) => {
      input.value = "";
      close();
      if (k < names.length) return this.goTo(k);
      const x = others.X[k - names.length];
      this.map.keepInView(x);
      this.change({ x: [...x], at: null, path: null });
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
  },

  setTheme(name) {
    this.theme = THEMES[name];
    this.element.dataset.theme = name;
    this.byId("theme").textContent = name === "dark" ? "Light" : "Dark";
    if (this.prediction) this.drawMap();
  },
};
