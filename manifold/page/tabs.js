// Tabs: one of several panels is shown. Arrow keys choose among them, as the ARIA practice of tabs has it.

/** Let the tabs of a tablist show their panels; `shown(id)` is told of the panel. Returns what shows the panel of an id. */
export function makeTabs(list, byId, shown) {
  const tabs = [...list.children];
  const show = (id) => {
    for (const tab of tabs) {
      const isShown = tab.getAttribute("aria-controls") === id;
      tab.setAttribute("aria-selected", String(isShown));
      tab.tabIndex = isShown ? 0 : -1;
      byId(tab.getAttribute("aria-controls")).hidden = !isShown;
    }
    shown(id);
  };
  tabs.forEach((tab, k) => {
    tab.addEventListener("click", () => show(tab.getAttribute("aria-controls")));
    tab.addEventListener("keydown", (event) => {
      const to = { ArrowLeft: k - 1, ArrowRight: k + 1, Home: 0, End: tabs.length - 1 }[event.key];
      if (to === undefined) return;
      event.preventDefault();
      const next = tabs[(to + tabs.length) % tabs.length];
      next.focus();
      show(next.getAttribute("aria-controls"));
    });
  });
  show(tabs[0].getAttribute("aria-controls"));
  return show;
}
