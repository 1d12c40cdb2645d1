// What only a served page can do: commands, asked of the program that serves it. A page that is a file has none.

const POLL = 600; // ms between looks at what is being done

/** Connect the controls of actions; null where the page is a file. */
export function serve(explorer, isServed) {
  if (!isServed) return null;
  const token = new URLSearchParams(location.search).get("token") ?? "";
  return new Actions(explorer, token);
}

class Actions {
  constructor(explorer, token) {
    this.explorer = explorer;
    this.token = token;
    this.items = new Map();
    const byId = (id) => document.getElementById(id);
    this.list = byId("jobs");
    byId("actions").hidden = false;
    for (const kind of ["predict", "render", "fit"]) {
      byId(`do-${kind}`).addEventListener("click", () => this.ask(kind, this.request(byId("action-name").value)));
    }
    byId("locate-file").addEventListener("change", (event) => this.locate(event.target.files[0]));
    this.look();
  }

  /** What the commands need to know of the place that is shown. */
  request(name) {
    const { state, spectrum } = this.explorer, request = { name, latent: state.x };
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

  async locate(file) {
    if (file) await this.post("/do/locate", { body: file, headers: { "Content-Type": "application/octet-stream" } });
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
      if (jobs.some((job) => job.state === "waiting" || job.state === "running")) {
        this.timer = setTimeout(() => this.look(), POLL);
      }
    } catch (error) {
      this.explorer.problem(`manifold explore does not answer: ${error.message}`);
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
    const isOpen = job.state === "waiting" || job.state === "running";
    const [words, bar, cancel] = item.children;
    const said = job.state === "failed" ? `: ${job.words}` : "";
    words.textContent = `${job.title}: ${job.state}${job.state === "waiting" ? "" : `, ${job.seconds.toFixed(0)} s`}${said}`;
    bar.hidden = cancel.hidden = !isOpen;
    if (item.dataset.state === job.state) return;
    item.dataset.state = job.state;
    if (!isOpen) document.getElementById("live").textContent = `${job.title}: ${job.state}`;
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
