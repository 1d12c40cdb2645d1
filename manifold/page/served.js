// Commands that a served page can request from its server; a page opened as a file has none.

import { percent } from "./elements.js";
import { Photo, isPicture } from "./photo.js";
import { isBetween } from "./state.js";

// ms between requests for the state of the jobs: after a command was requested, in the end, and at most, while the server does
// not answer
const SOON = 100, POLL = 600, LONGEST = 30_000;

/** Connect the controls of actions; null where the page is a file. */
export function serve(explorer, { served }) {
  if (!served) return null;
  const token = new URLSearchParams(location.search).get("token") ?? "";
  return new Actions(explorer, token, served.targets);
}

const LOCATING = new Set(["locate", "photograph"]); // commands that find a place
const OPEN = new Set(["waiting", "running"]); // states of unfinished jobs
const MAGIC = "tensor_file"; // of RGL's .bsdf files
const isPairOfNumbers = (line) => /^\s*[-+.\deE]+[\s,;]+[-+.\deE]+\s*$/.test(line);

/** Whether a text is a table of wavelengths and reflectances, not of readings: most lines are two numbers. */
const isSpectrum = (text) => {
  const lines = text.split(/\r?\n/).filter((line) => line.trim());
  return 2 * lines.filter(isPairOfNumbers).length > lines.length;
};

/** The latent as commands take it, or FROM:TO:T between two materials. */
const latentOf = (state) => (isBetween(state) ? [state.path.from, state.path.to, state.path.t].join(":") : state.x);

/** A file's own name without the characters that the server does not accept. */
const plainName = (file) =>
  file.name.replace(/\.[^.]*$/, "").replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^[-_]+/, "").slice(0, 60);

const headingOf = ({ command, subject }) => `${command} ${subject}`;

/** The error of a fit, of an export, or of a completed material, as text. */
function summary({ command, result }, lights) {
  if (command === "fit" || command === "export") {
    const principled = result.principled_errors, { ball, worst, worst_light } = result.errors;
    return `error ${ball.toFixed(2)} CIEDE2000 of the ball (mean of ${lights})`
      + (worst_light ? `, in ${worst_light} ${worst.toFixed(2)}` : "")
      + (principled ? `; principled ${principled.ball.toFixed(2)}` : "");
  }
  if (result.made_of) {
    const like = Object.entries(result.made_of).slice(0, 3).map(([name, weight]) => `${weight.toFixed(2)} ${name}`);
    const notes = result.located ? result.diagnostics : []; // of the photograph, too
    return [`expected error ${result.expected.ball.toFixed(1)} CIEDE2000 of the ball (mean of ${lights}), made of ${like.join(", ")}`, ...notes].join("; ");
  }
  return "";
}

class Actions {
  constructor(explorer, token, targets) {
    this.explorer = explorer;
    this.token = token;
    this.items = new Map();
    this.requested = new Map(); // names of what this page has asked to locate, by the number of the job
    this.wait = POLL;
    const byId = (id) => explorer.byId(id);
    this.list = byId("jobs");
    byId("actions").hidden = false;
    byId("actions-need").hidden = true;
    for (const kind of ["predict", "render", "fit"]) {
      byId(`do-${kind}`).addEventListener("click", () => this.requestAll(kind));
    }
    byId("export-target").append(...targets.map(([name, title]) => new Option(title, name)));
    byId("do-export").addEventListener("click", () => this.requestAll("export",
      { target: byId("export-target").value }));
    for (const kind of ["locate", "complete"]) {
      byId(`${kind}-file`).addEventListener("change", (event) => {
        const [file] = event.target.files;
        event.target.value = ""; // so that the same file can be chosen again
        if (file) this[kind](file);
      });
    }
    this.photo = new Photo(explorer, (file, request, light) => this.locatePhoto(file, request, light));
    window.addEventListener("focus", () => this.poll()); // another tab may have requested a job
    this.poll();
  }

  /** Whether files of the same name may be replaced; else new ones get a number. */
  get replaces() {
    return this.explorer.byId("action-replace").checked;
  }

  /** Request a command for the look on the page or, numbered, for all that are kept. */
  async requestAll(kind, options = {}) {
    const looks = this.explorer.looks(), name = this.explorer.byId("action-name").value;
    for (const [k, look] of looks.entries()) {
      if (look.without) {
        this.explorer.problem("commands predict from all materials; choose another point");
        return;
      }
      if (look.colour === "own") {
        this.explorer.problem(this.explorer.guests[look.guest].surface === undefined
          ? "the colours of a dropped file are in `manifold locate FILE --output NEW`; choose others here"
          : "the files of a surface are those that `manifold surface` wrote; choose a point on the map here");
      } else if (!await this.request(kind, { ...this.place(look), ...options, name: looks.length > 1 ? `${name}-${k + 1}` : name })) {
        return;
      }
    }
  }

  /** A look's latent and colour, as requests hold them. */
  place(look) {
    const place = { latent: latentOf(look), replace: this.replaces };
    if (look.colour === "like") place.like = look.like;
    if (look.colour === "picked") place.srgb = look.srgb;
    if (look.colour === "file") place.spectrum = this.explorer.spectra[look.spectrum].rows;
    if (look.colour === "lch") Object.assign(place, this.explorer.plainColour(look));
    return place;
  }

  async send(path, options = {}) {
    const headers = { "X-Token": this.token, ...options.headers };
    const response = await fetch(path, { ...options, headers });
    if (!response.ok) throw new Error((await response.json()).error);
    return response;
  }

  async request(kind, request) {
    const headers = { "Content-Type": "application/json" };
    return this.post(`/do/${kind}`, { body: JSON.stringify(request), headers });
  }

  /** Take a file that was dropped, unless it is a spectrum; whether it was taken. */
  async take(file) {
    if (isPicture(file)) {
      this.explorer.showTab("photo");
      await this.photo.show(file);
      return true;
    }
    if ((await file.slice(0, MAGIC.length).text()) === MAGIC) this.locate(file);
    else if (file.size > 1e6 || !isSpectrum(await file.text())) this.complete(file);
    else return false;
    this.explorer.showTab("export"); // where its progress is
    return true;
  }

  async locate(file) {
    await this.requestOf("locate", file, { name: plainName(file) || "file" });
  }

  /** The light, where it is a file, follows the photograph. */
  async locatePhoto(file, request, light) {
    const sent = new Blob(light ? [file, light] : [file]);
    request = { ...request, name: plainName(file) || "photo", replace: this.replaces };
    if (await this.requestOf("photograph", sent, request)) this.explorer.showTab("export");
  }

  /** The completed file has the name of the readings, as far as the server accepts it. */
  async complete(file) {
    const sample = this.explorer.byId("sample").value.trim();
    await this.requestOf("complete", file, { name: plainName(file) || "completed", sample, replace: this.replaces });
  }

  /** Request a command of a file. */
  async requestOf(kind, file, request) {
    const headers = { "Content-Type": "application/octet-stream", "X-Request": encodeURIComponent(JSON.stringify(request)) };
    return this.post(`/do/${kind}`, { body: file, headers }, kind === "complete" ? null : request.name);
  }

  /** Whether a request was accepted; if not, the page says why. What is to be located has a name. */
  async post(path, options, name = null) {
    try {
      const { number } = await (await this.send(path, { method: "POST", ...options })).json();
      if (name !== null) this.requested.set(number, name);
      this.explorer.problem("");
      return true;
    } catch (error) {
      this.explorer.problem(error.message);
      return false;
    } finally {
      this.wait = SOON;
      this.poll();
    }
  }

  async poll() {
    clearTimeout(this.timer);
    try {
      const { jobs } = await (await this.send("/jobs")).json();
      for (const job of jobs) this.show(job);
      if (this.wait > POLL) this.explorer.problem("");
      this.wait = Math.min(1.2 * this.wait, POLL);
    } catch (error) {
      this.explorer.problem(`manifold explore does not respond: ${error.message}`);
      this.wait = Math.min(2 * Math.max(this.wait, POLL), LONGEST);
    }
    if ([...this.list.children].some((item) => OPEN.has(item.dataset.state))) {
      this.timer = setTimeout(() => this.poll(), this.wait);
    }
  }

  show(job) {
    const item = this.items.get(job.number) ?? this.addItem(job);
    const isOpen = OPEN.has(job.state), [details] = item.children, heading = headingOf(job);
    const [title, bar, cancel, text] = details.children;
    const detail = job.state === "failed" ? job.message : job.state === "done" ? summary(job, this.explorer.data.lights) : "";
    const isKnown = job.state === "running" && job.share !== null;
    const share = isKnown ? `, ${percent(job.share)}${job.stage && `, ${job.stage}`}` : "";
    const seconds = job.state === "waiting" ? "" : `, ${job.seconds.toFixed(0)} s`;
    title.textContent = `${heading}: ${job.state}${share}${seconds}`;
    text.textContent = detail;
    if (isKnown) bar.value = job.share;
    else bar.removeAttribute("value");
    bar.hidden = cancel.hidden = !isOpen;
    if (item.dataset.state === job.state) return;
    item.dataset.state = job.state;
    details.open = isOpen || job.state === "failed"; // what is done collapses
    if (job.state !== "running") this.explorer.announce([`${heading}: ${job.state}`, detail].filter((part) => part).join(", "));
    if (job.state === "done" && job.picture) this.showPicture(details, job);
    const [seen] = job.result?.photographs ?? [];
    if (job.state === "done" && seen && this.requested.has(job.number)) this.photo.showFound(seen);
    const found = job.result?.located ?? job.result;
    if (job.state === "done" && LOCATING.has(job.command) && found.latent) this.showPlace(details, job, found);
  }

  addItem(job) {
    const item = document.createElement("li"), details = document.createElement("details");
    const [title, bar, cancel, text] = ["summary", "progress", "button", "p"].map((name) => document.createElement(name));
    cancel.type = "button";
    cancel.textContent = "Cancel";
    cancel.addEventListener("click", () => this.request("cancel", { number: job.number }));
    bar.setAttribute("aria-label", `progress of ${headingOf(job)}`);
    details.append(title, bar, cancel, text);
    item.append(details);
    this.items.set(job.number, item);
    this.list.prepend(item);
    return item;
  }

  async showPicture(item, job) {
    const picture = await (await this.send(`/picture/${job.number}`)).blob();
    const image = document.createElement("img");
    image.src = URL.createObjectURL(picture);
    image.alt = headingOf(job);
    item.append(image);
  }

  /** What was located stands on the map, in its own colours; where another tab located it, after a click. */
  showPlace(item, job, result) {
    const { latent, nearest } = result, button = document.createElement("button");
    const show = () => this.explorer.addGuest({ ...result, name: this.requested.get(job.number) ?? job.subject });
    button.type = "button";
    button.textContent = `Show at ${latent.map((v) => v.toFixed(2)).join(", ")}, near ${nearest[0][0]}`;
    button.addEventListener("click", show);
    item.append(button);
    if (this.requested.has(job.number)) show();
  }
}
