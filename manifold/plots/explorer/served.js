// What only a served page can do: commands, asked of the program that serves it. A page that is a file has none.

import { percent } from "./elements.js";
import { isBetween } from "./state.js";

const POLL = 600, LONGEST = 30_000; // ms between looks at what is being done; where no answer comes

/** Connect the controls of actions; null where the page is a file. */
export function serve(explorer, { served }) {
  if (!served) return null;
  const token = new URLSearchParams(location.search).get("token") ?? "";
  return new Actions(explorer, token, served.targets);
}

const OPEN = new Set(["waiting", "running"]); // states of work that is not done
const MAGIC = "tensor_file"; // of RGL's .bsdf files
const isPairOfNumbers = (line) => /^\s*[-+.\deE]+[\s,;]+[-+.\deE]+\s*$/.test(line);

/** Whether a text is a table of wavelengths and reflectances, not of readings: most lines are two numbers. */
const isSpectrum = (text) => {
  const lines = text.split(/\r?\n/).filter((line) => line.trim());
  return 2 * lines.filter(isPairOfNumbers).length > lines.length;
};

/** The place that commands are given: a latent, or FROM:TO:T between two materials. */
const placeOf = (state) => (isBetween(state) ? [state.path.from, state.path.to, state.path.t].join(":") : state.x);

/** A name that the program takes for a file, as near to a file's own as can be. */
const plainName = (file) =>
  file.name.replace(/\.[^.]*$/, "").replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^[-_]+/, "").slice(0, 60);

/** What a result says in a sentence: what an export loses, or the error that a completed material has. */
function inWords(result) {
  const made = result?.exports?.[0];
  if (made) {
    const principled = made.principled_ciede2000;
    return `, error ${made.ciede2000.toFixed(2)} CIEDE2000` + (principled === null ? "" : `; principled loses ${principled.toFixed(2)}`);
  }
  if (result?.expected) {
    const like = Object.entries(result.made_of).slice(0, 3).map(([name, weight]) => `${weight.toFixed(2)} ${name}`);
    return `, expected error ${result.expected.ball.toFixed(1)} CIEDE2000, made of ${like.join(", ")}`;
  }
  return "";
}

class Actions {
  constructor(explorer, token, targets) {
    this.explorer = explorer;
    this.token = token;
    this.items = new Map();
    this.wait = POLL;
    const byId = (id) => explorer.byId(id);
    this.list = byId("jobs");
    byId("actions").hidden = false;
    for (const kind of ["predict", "render", "fit"]) {
      byId(`do-${kind}`).addEventListener("click", () => this.ask(kind, this.request()));
    }
    byId("export-target").append(...targets.map(([name, title]) => new Option(title, name)));
    byId("do-export").addEventListener("click", () => this.ask("export",
      { ...this.request(), target: byId("export-target").value, direct: byId("export-direct").checked }));
    for (const kind of ["locate", "complete"]) {
      byId(`${kind}-file`).addEventListener("change", (event) => {
        const [file] = event.target.files;
        event.target.value = ""; // so that the same file can be chosen again
        if (file) this[kind](file);
      });
    }
    window.addEventListener("focus", () => this.look()); // another tab may have asked for something
    this.look();
  }

  /** Whether files of the same name may be replaced; else new ones get a number. */
  get replaces() {
    return this.explorer.byId("action-replace").checked;
  }

  /** What the commands need to know of the place that is shown. */
  request() {
    const { state, spectrum } = this.explorer;
    const request = { name: this.explorer.byId("action-name").value, latent: placeOf(state), replace: this.replaces };
    if (state.colour === "like") request.like = state.like;
    if (state.colour === "picked") request.srgb = state.srgb;
    if (state.colour === "file" && spectrum) request.spectrum = spectrum.rows;
    return request;
  }

  async send(path, options = {}) {
    const headers = { "X-Token": this.token, ...options.headers };
    const response = await fetch(path, { ...options, headers });
    if (!response.ok) throw new Error((await response.json()).error);
    return response;
  }

  async ask(kind, request) {
    const headers = { "Content-Type": "application/json" };
    return this.post(`/do/${kind}`, { body: JSON.stringify(request), headers });
  }

  /** Take a file that was dropped, unless it is a spectrum; whether it was taken. */
  async take(file) {
    if ((await file.slice(0, MAGIC.length).text()) === MAGIC) this.locate(file);
    else if (file.size > 1e6 || !isSpectrum(await file.text())) this.complete(file);
    else return false;
    return true;
  }

  async locate(file) {
    const headers = { "Content-Type": "application/octet-stream", "X-Name": plainName(file) || "file" };
    await this.post("/do/locate", { body: file, headers });
  }

  /** The completed file is called like the readings, as far as its name is plain. */
  async complete(file) {
    const sample = encodeURIComponent(this.explorer.byId("sample").value.trim());
    const headers = { "Content-Type": "application/octet-stream", "X-Name": plainName(file) || "completed", "X-Sample": sample,
      "X-Replace": String(this.replaces) };
    await this.post("/do/complete", { body: file, headers });
  }

  async post(path, options) {
    try {
      await this.send(path, { method: "POST", ...options });
      this.explorer.problem("");
    } catch (error) {
      this.explorer.problem(error.message);
    }
    this.look();
  }

  async look() {
    clearTimeout(this.timer);
    try {
      const { jobs } = await (await this.send("/jobs")).json();
      for (const job of jobs) this.show(job);
      if (this.wait > POLL) this.explorer.problem("");
      this.wait = POLL;
    } catch (error) {
      this.explorer.problem(`manifold explore does not respond: ${error.message}`);
      this.wait = Math.min(2 * this.wait, LONGEST);
    }
    if ([...this.list.children].some((item) => OPEN.has(item.dataset.state))) {
      this.timer = setTimeout(() => this.look(), this.wait);
    }
  }

  show(job) {
    let item = this.items.get(job.number);
    if (!item) {
      item = document.createElement("li");
      const words = document.createElement("span"), bar = document.createElement("progress");
      const cancel = document.createElement("button");
      cancel.type = "button";
      cancel.textContent = "Cancel";
      cancel.addEventListener("click", () => this.ask("cancel", { number: job.number }));
      bar.setAttribute("aria-label", `progress of ${job.title}`);
      item.append(words, " ", bar, " ", cancel);
      this.items.set(job.number, item);
      this.list.prepend(item);
    }
    const isOpen = OPEN.has(job.state);
    const [words, bar, cancel] = item.children;
    const said = job.state === "failed" ? `: ${job.words}` : job.state === "done" ? inWords(job.result) : "";
    const isKnown = job.state === "running" && job.share !== null;
    const share = isKnown ? `, ${percent(job.share)}${job.stage && `, ${job.stage}`}` : "";
    const seconds = job.state === "waiting" ? "" : `, ${job.seconds.toFixed(0)} s`;
    words.textContent = `${job.title}: ${job.state}${share}${seconds}${said}`;
    if (isKnown) bar.value = job.share;
    else bar.removeAttribute("value");
    bar.hidden = cancel.hidden = !isOpen;
    if (item.dataset.state === job.state) return;
    item.dataset.state = job.state;
    if (job.state !== "running") this.explorer.say(`${job.title}: ${job.state}${said}`);
    if (job.state === "done" && job.picture) this.showPicture(item, job);
    if (job.state === "done" && job.result?.latent) this.showPlace(item, job.result);
  }

  async showPicture(item, job) {
    const picture = await (await this.send(`/picture/${job.number}`)).blob();
    const image = document.createElement("img");
    image.src = URL.createObjectURL(picture);
    image.alt = job.title;
    item.append(image);
  }

  showPlace(item, { latent, nearest }) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = `Go to ${latent.map((v) => v.toFixed(2)).join(", ")}, near ${nearest[0][0]}`;
    button.addEventListener("click", () => this.explorer.change({ x: latent }));
    item.append(button);
  }
}
