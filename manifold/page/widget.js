// The page as a widget of a notebook, by the conventions of anywidget: its state is in traits of the model.

import { Materials } from "./numerics.js";
import { Explorer } from "./explorer.js";
import { isBetween } from "./state.js";

/** The state of one view, kept in the model that all views share. */
function linkTo(model, listening) {
  const on = (trait, changed) => {
    model.on(`change:${trait}`, changed);
    listening.push(() => model.off(`change:${trait}`, changed));
  };
  return {
    on,
    read: () => model.get("link"),
    write: (fragment, explorer) => {
      if (model.get("link") === fragment) return;
      const { colour, like, srgb, path } = explorer.state;
      const blend = isBetween(explorer.state) ? { between: [path.from, path.to, path.t] } : {};
      const chosen = { blend, like: { like }, picked: { srgb }, file: { spectrum: explorer.spectrum?.rows } };
      if (colour === "lch") chosen.lch = explorer.plainColour(explorer.state);
      model.set("link", fragment);
      model.set("latent", [...explorer.state.x]);
      model.set("colour", chosen[colour] ?? {}); // that of a dropped file is not passed on
      model.save_changes();
    },
    listen: (changed) => on("link", changed),
    address: () => "",
  };
}

async function render({ model, el }) {
  const host = document.createElement("div"), listening = [];
  el.append(host);
  // Keys on the map are not the notebook's: JupyterLab looks for the attribute, others listen further up.
  host.setAttribute("data-lm-suppress-shortcuts", "true");
  host.addEventListener("keydown", (event) => event.stopPropagation());
  const root = host.attachShadow({ mode: "open" });
  const style = document.createElement("style"), element = document.createElement("div");
  style.textContent = STYLE;
  element.className = "explorer";
  element.append(...new DOMParser().parseFromString(BODY, "text/html").body.childNodes);
  root.append(style, element);
  root.getElementById("link").hidden = true; // a widget has no address
  const data = model.get("data"), link = linkTo(model, listening);
  const explorer = new Explorer(data, await Materials.load(data), { root, element, link });
  explorer.start();
  link.on("latent", () => {
    const x = model.get("latent");
    if (String(x) !== String(explorer.state.x)) explorer.change({ x: [...x] });
  });
  return () => {
    for (const stop of listening) stop();
    explorer.balls?.gl.getExtension("WEBGL_lose_context")?.loseContext();
    host.remove();
  };
}

export default { render };
