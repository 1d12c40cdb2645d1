// Places of balls and names on the map. No page is touched here.

const STEPS = 200, ATTRACTION = 0.02, GAP = 1.06; // as in manifold/pictures/plot_balls.py
const LINE = 13; // letters of a name before it is broken

/** A name in at most two lines of some thirteen letters. */
export function inLines(name) {
  const lines = [];
  for (const word of name.replace(/^syn_/, "").split(/[_\s]+/)) {
    const last = lines[lines.length - 1];
    if (last !== undefined && last.length + 1 + word.length <= LINE) lines[lines.length - 1] = `${last} ${word}`;
    else lines.push(word);
  }
  const cut = (line) => (line.length > 2 * LINE ? `${line.slice(0, 2 * LINE - 1)}…` : line);
  return lines.length > 2 ? [cut(lines[0]), `${cut(lines[1])} …`] : lines.map(cut);
}

/**
 * Points [x, y] moved apart until boxes of size `room` ([width, height] each) around them hardly overlap, near where they
 * were; those that begin inside a frame of some width and height stay in it.
 */
export function spread(points, room, width, height) {
  const places = points.map(([x, y], k) => [x + 1e-3 * Math.sin(12.9 * k), y + 1e-3 * Math.cos(78.2 * k)]);
  const inside = points.flatMap(([x, y], k) => (x >= 0 && x <= width && y >= 0 && y <= height ? [k] : []));
  for (let step = 0; step < STEPS; step++) {
    const push = places.map(() => [0, 0]);
    inside.forEach((i, a) => {
      for (const j of inside.slice(a + 1)) {
        const across = (0.5 * GAP) * (room[i][0] + room[j][0]), down = (0.5 * GAP) * (room[i][1] + room[j][1]);
        const x = (places[i][0] - places[j][0]) / across, y = (places[i][1] - places[j][1]) / down;
        const overlap = 1 - Math.max(Math.abs(x), Math.abs(y));
        if (overlap <= 0) continue;
        const by = (0.5 * overlap) / Math.max(Math.hypot(x, y), 1e-9);
        for (const [k, sign] of [[i, 1], [j, -1]]) {
          push[k][0] += sign * by * x * room[k][0];
          push[k][1] += sign * by * y * room[k][1];
        }
      }
    });
    const pull = ATTRACTION * (1 - step / STEPS);
    for (const k of inside) {
      [width, height].forEach((size, c) => {
        const moved = places[k][c] + push[k][c] + pull * (points[k][c] - places[k][c]), half = 0.5 * room[k][c];
        places[k][c] = Math.min(Math.max(moved, half), Math.max(size - half, half));
      });
    }
  }
  return places;
}
