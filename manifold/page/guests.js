// Surfaces, and dropped materials: in their own colours at their place on the map, until they are removed; methods of the page.

export const guests = {
  /** Take what `manifold locate` has found of a file: {name, latent, colours, expected, errors, diagnostics}. */
  addGuest(found) {
    const at = (row) => this.data.nodes.map((band) => row[band]);
    const guest = { ...found, x: found.latent, coordinates: at(found.colours[0]), gains: at(found.colours[1]) };
    this.showGuest(this.guests.push(guest) - 1);
    this.showGuests();
  },

  showGuest(index) {
    this.change({ x: [...this.guests[index].x], colour: "own", guest: index, path: null });
  },

  /** The list of surfaces and dropped materials, and their balls on the map. */
  showGuests() {
    const present = this.guests.flatMap((guest, k) => (guest.isRemoved ? [] : [k]));
    this.map.setGuests(present, present.map((k) => {
      const { name, x } = this.guests[k], look = { colour: "own", guest: k, x };
      return { name, x, image: this.pictureOf(look) };
    }));
    this.hover = -1;
    this.byId("guests").hidden = !present.length;
    this.byId("guests").replaceChildren(...present.map((k) => {
      const { name, surface, apart, errors, diagnostics } = this.guests[k], item = document.createElement("li");
      const show = document.createElement("button"), remove = document.createElement("button");
      show.type = remove.type = "button";
      show.textContent = name;
      show.addEventListener("click", () => this.showGuest(k));
      remove.textContent = "Remove";
      remove.setAttribute("aria-label", `Remove ${name}`);
      remove.addEventListener("click", () => this.removeGuest(k));
      const text = surface === undefined
        ? `: the map shows it within ${errors.ball.toFixed(1)} CIEDE2000 of its ball (mean of ${this.data.lights}), cube root ${errors.cube_root.toFixed(3)}`
        : `: a surface; without it the map shows the ball of its mean within ${apart.toFixed(1)} CIEDE2000 (mean of ${this.data.lights})`;
      item.append(show, [text, ...diagnostics].join("; "), " ", remove);
      return item;
    }));
    this.drawMap();
  },

  /** Its place and colours stay, so that undo and kept looks still show it. */
  removeGuest(k) {
    this.guests[k].isRemoved = true;
    this.showGuests();
    this.byId("map").focus({ preventScroll: true });
  },
};
