// node firefox.cjs ADDRESS PLACES: the page of a map in Firefox, as a visitor uses it; prints what was found as JSON.
// PLACES: on the ball, in radii, as JSON. NODE_PATH holds puppeteer-core.

const puppeteer = require("puppeteer-core");

/** No event is waiting, and no frame is to be drawn. */
const settled = (page) => page.evaluate(async () => {
  do {
    await new Promise((done) => setTimeout(done));
    await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  } while (window.explorer.requested);
});
const stateOf = (page) => page.evaluate(() => structuredClone(window.explorer.state));

async function openPage(browser, address, errors) {
  const page = await browser.newPage();
  await page.setViewport({ width: 1280, height: 900 });
  page.on("console", (message) => message.type() === "error" && errors.push(message.text()));
  page.on("pageerror", (error) => errors.push(String(error)));
  await page.goto(address);
  await page.waitForSelector("[data-complete], #problem:not([hidden])");
  return page;
}

async function drag(page) {
  await page.$eval("#map", (map) => map.scrollIntoView({ block: "center" }));
  const { x, y } = await (await page.$("#map")).boundingBox();
  await page.mouse.move(x + 20, y + 20);
  await page.mouse.down();
  await page.mouse.move(x + 160, y + 250, { steps: 4 });
  await settled(page);
  await page.mouse.up();
  await settled(page);
  return stateOf(page);
}

async function press(page, ...keys) {
  for (const key of keys) await page.keyboard.press(key);
  await settled(page);
  return stateOf(page);
}

async function search(page, text) {
  await page.keyboard.press("/");
  await page.keyboard.type(text);
  return press(page, "Enter");
}

async function scrub(page) {
  await page.evaluate(() => window.explorer.showTab("compare"));
  await page.focus("#walk-t");
  return press(page, "Home", "ArrowRight", "ArrowRight");
}

/** The reflectance that a dropped spectrum gives. */
async function dropSpectrum(page) {
  await page.evaluate(() => {
    const files = new DataTransfer();
    files.items.add(new File(["400 0.1\n500 0.1\n600 0.6\n700 0.6\n"], "red.txt"));
    document.dispatchEvent(new DragEvent("drop", { dataTransfer: files, bubbles: true, cancelable: true }));
  });
  await page.waitForFunction(() => document.getElementById("caption").textContent.includes("red.txt"));
  return page.evaluate(() => window.explorer.reflectance);
}

const ballAt = (page, places) => page.evaluate((places) => {
  const { explorer } = window, { gl } = explorer.balls;
  explorer.balls.refine(0);
  explorer.drawBalls();
  const { width, height } = gl.canvas, { side } = window.explorer.balls, picture = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, picture);
  return places.map(([x, y]) => {
    const [i, j] = [x, y].map((v, k) => Math.floor([width, height][k] / 2 + (v / 1.02) * side / 2));
    return [...picture.slice(4 * (j * width + i), 4 * (j * width + i) + 3)];
  });
}, places);

async function main(address, places) {
  const browser = await puppeteer.launch({
    browser: "firefox", executablePath: process.env.FIREFOX, headless: true,
    extraPrefsFirefox: { "webgl.force-enabled": true }, // by software
  });
  const found = { errors: [] };
  try {
    const page = await openPage(browser, address, found.errors);
    found.problem = await page.$eval("#problem-text", (e) => e.textContent);
    if (!found.problem) {
      found.dragged = await drag(page);
      found.ball = await ballAt(page, places);
      found.pressed = await press(page, "ArrowRight", "Enter");
      found.searched = await search(page, "copper");
      found.scrubbed = await scrub(page);
      await page.focus("#map");
      found.left = await press(page, "ArrowLeft");
      await page.reload(); // Firefox keeps what forms held
      await page.waitForSelector("[data-ready]");
      found.reloaded = await stateOf(page);
      found.slider = await page.$eval("#walk-t", (e) => e.value);
      found.red = await dropSpectrum(page);
    }
  } finally {
    await browser.close();
  }
  console.log(JSON.stringify(found));
}

main(process.argv[2], JSON.parse(process.argv[3]));
