// A photographed ball: its outline is dragged, its light chosen, and `manifold photograph` estimates its material.

const SUFFIX = /\.(exr|hdr|pfm|tiff?|png|jpe?g|bmp|webp)$/i;
const LARGEST = 640; // pixels of the longer side in which a photograph is shown
const GRIP = 24; // pixels of the screen beside the outline within which a drag changes the radius

export const isPicture = (file) => SUFFIX.test(file.name);
const suffixOf = (file) => SUFFIX.exec(file.name)[0].toLowerCase();

/** What is asked of one photograph; `locate(file, request, light)` sends it. */
export class Photo {
  constructor(explorer, locate) {
    const byId = (id) => explorer.byId(`photo-${id}`);
    Object.assign(this, { explorer, byId, locate, file: null, light: null, image: null, circle: null });
    this.canvas = byId("canvas");
    byId("needs").hidden = true;
    byId("form").hidden = false;
    this.listenToFile("file", (file) => this.show(file));
    this.listenToFile("light-file", (file) => this.useLight(file));
    byId("light").addEventListener("change", ({ target }) => target.value || byId("light-file").click());
    byId("circle").addEventListener("change", () => this.readCircle());
    byId("lamp").addEventListener("change", ({ target }) => {
      if (target.value.trim()) byId("light").value = "lamp";
      this.draw();
    });
    byId("find").addEventListener("click", () => this.find());
    this.canvas.addEventListener("pointerdown", (event) => this.grab(event));
    this.canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const kind of ["pointerup", "pointercancel"]) this.canvas.addEventListener(kind, () => (this.grip = null));
  }

  listenToFile(id, take) {
    this.byId(id).addEventListener("change", ({ target }) => {
      const [file] = target.files;
      target.value = ""; // so that the same file can be chosen again
      if (file) take(file);
    });
  }

  /** Show a photograph; of those that a browser cannot show, the outline is found, or written. */
  async show(file) {
    Object.assign(this, { file, image: null, circle: null });
    this.byId("circle").value = "";
    this.byId("name").textContent = file.name;
    this.byId("find").disabled = false;
    try {
      this.image = await createImageBitmap(file);
    } catch {
      this.image = null;
    }
    if (this.file !== file) return; // another was chosen meanwhile
    this.byId("unseen").hidden = this.image !== null;
    this.canvas.hidden = this.image === null;
    if (this.image) {
      const { width, height } = this.image, scale = Math.min(1, LARGEST / Math.max(width, height));
      this.canvas.width = Math.round(width * scale);
      this.canvas.height = Math.round(height * scale);
    }
    this.draw();
  }

  useLight(file) {
    const select = this.byId("light"), own = [...select.options].find((option) => option.value === "");
    this.light = file;
    own.textContent = file.name;
    own.selected = true;
  }

  /** The outline as the field has it; empty, it is found. */
  readCircle() {
    const numbers = this.byId("circle").value.split(",").map(Number);
    this.circle = numbers.length === 3 && numbers.every(Number.isFinite) ? numbers : null;
    this.draw();
  }

  /** Where the lamp that the field has makes its highlight, in the photograph; null without one. */
  highlight() {
    const lamp = this.byId("lamp").value.split(",").map(Number).slice(0, 3), length = Math.hypot(...lamp);
    if (!this.circle || this.byId("light").value !== "lamp" || lamp.length < 3 || !(length > 0)) return null;
    const half = [lamp[0] / length, lamp[1] / length, lamp[2] / length + 1], [x, y, radius] = this.circle;
    const size = Math.hypot(...half);
    return size > 0 ? [x + radius * half[0] / size, y - radius * half[1] / size] : null;
  }

  /** The lamp whose highlight is at a place of the photograph. */
  lampAt(px, py) {
    const [x, y, radius] = this.circle, within = Math.max(Math.hypot(px - x, py - y) / (0.999 * radius), 1);
    const nx = (px - x) / radius / within, ny = (y - py) / radius / within, nz = Math.sqrt(1 - nx * nx - ny * ny);
    return [2 * nz * nx, 2 * nz * ny, 2 * nz * nz - 1];
  }

  /** What the program found in a photograph: its outline and lamp, to be dragged where they are wrong. */
  showFound({ circle, lamps }) {
    this.circle = circle.slice(0, 3);
    this.byId("circle").value = this.circle.map((v) => v.toFixed(1)).join(",");
    if (lamps.length) this.byId("lamp").value = lamps[0].map((v) => v.toFixed(3)).join(",");
    this.draw();
  }

  /** Pixels of the photograph by pixels of the screen, and where a pointer is in the photograph. */
  at(event) {
    const box = this.canvas.getBoundingClientRect(), scale = this.image.width / box.width;
    return { scale, x: (event.clientX - box.left) * scale, y: (event.clientY - box.top) * scale };
  }

  /**
   * A lamp's highlight is dragged; near the outline a drag changes the radius, within it the place; elsewhere it draws an
   * outline from its middle.
   */
  grab(event) {
    const { scale, x, y } = this.at(event), [cx, cy, radius] = this.circle ?? [0, 0, 0];
    const away = Math.hypot(x - cx, y - cy);
    const shine = this.highlight();
    this.canvas.setPointerCapture(event.pointerId);
    if (shine && Math.hypot(x - shine[0], y - shine[1]) < GRIP * scale) this.grip = { lamp: true };
    else if (this.circle && Math.abs(away - radius) < GRIP * scale) this.grip = { radius: radius - away };
    else if (this.circle && away < radius) this.grip = { dx: cx - x, dy: cy - y };
    else {
      this.circle = [x, y, 1];
      this.grip = { radius: 0 };
    }
  }

  drag(event) {
    if (!this.grip) return;
    const { x, y } = this.at(event), [cx, cy, radius] = this.circle, { width, height } = this.image;
    const within = (v, most) => Math.min(Math.max(v, 0), most);
    if (this.grip.lamp) {
      this.byId("lamp").value = this.lampAt(x, y).map((v) => v.toFixed(3)).join(",");
      this.draw();
      return;
    }
    this.circle = "radius" in this.grip
      ? [cx, cy, within(Math.hypot(x - cx, y - cy) + this.grip.radius, Math.max(width, height))]
      : [within(x + this.grip.dx, width), within(y + this.grip.dy, height), radius];
    this.byId("circle").value = this.circle.map((v) => v.toFixed(1)).join(",");
    this.draw();
  }

  draw() {
    if (!this.image) return;
    const { width, height } = this.canvas, context = this.canvas.getContext("2d");
    context.drawImage(this.image, 0, 0, width, height);
    if (!this.circle) return;
    const scale = width / this.image.width, [x, y, radius] = this.circle.map((v) => v * scale);
    for (const [style, thick] of [["#000", 4], ["#fff", 2]]) {
      context.beginPath();
      context.arc(x, y, radius, 0, 2 * Math.PI);
      context.moveTo(x - 6, y);
      context.lineTo(x + 6, y);
      context.moveTo(x, y - 6);
      context.lineTo(x, y + 6);
      const shine = this.highlight()?.map((v) => v * scale);
      if (shine) {
        context.moveTo(shine[0] + 9, shine[1]);
        context.arc(shine[0], shine[1], 9, 0, 2 * Math.PI);
      }
      Object.assign(context, { strokeStyle: style, lineWidth: thick });
      context.stroke();
    }
  }

  find() {
    const light = this.byId("light").value ? null : this.light;
    if (light || this.byId("light").value) this.locate(this.file, this.request(light), light);
    else this.explorer.problem("no picture of the light was chosen; choose one, or a light by its name");
  }

  /** As the server takes it. */
  request(light) {
    const value = (id) => this.byId(id).value.trim(), request = { suffix: suffixOf(this.file) };
    if (light) Object.assign(request, { light_suffix: suffixOf(light), light_bytes: light.size });
    else if (value("light") === "lamp") request.lamp = value("lamp") || "found";
    else request.light = value("light");
    if (value("circle")) request.circle = value("circle");
    const numbers = request.lamp ? ["distance"] : ["turn", "elevation", "distance"]; // lamps are in the camera's frame
    for (const id of numbers) if (value(id)) request[id] = Number(value(id));
    if (this.byId("exposure").checked) request.exposure = "free";
    return request;
  }
}
