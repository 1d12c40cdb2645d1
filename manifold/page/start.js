// The page as a document of its own: its state is in its address.

import { Materials } from "./numerics.js";
import { Explorer } from "./explorer.js";
import { serve } from "./served.js";

const link = {
  read: () => location.hash.replace(/^#/, ""),
  write: (fragment) => link.read() === fragment || history.replaceState(null, "", `#${fragment}`),
  listen: (changed) => window.addEventListener("hashchange", changed),
  address: () => location.href,
};

const data = JSON.parse(document.getElementById("data").textContent);
const explorer = new Explorer(data, await Materials.load(data), { root: document, element: document.body, link });
explorer.server = serve(explorer, data);
explorer.start();
window.explorer = explorer; // for scripts and tests
