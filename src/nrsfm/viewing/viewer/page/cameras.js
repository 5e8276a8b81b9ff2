// Lines for the cameras, in the object's coordinates: a pyramid for a camera with a place, a prism for an orthographic
// one, which has parallel rays and, in truth, no place; and the path from frame to frame.

const EACH = 16; // vertices of one camera
const MOST = 48; // cameras drawn at once

export function cameraLines(scene, radius) {
  const { places, aspect, kind } = scene.cameras;
  const count = scene.frames;
  const long = 0.2 * radius, half = kind === "orthographic" ? 0.1 * radius : scene.cameras.slope * long;
  const vertices = new Float32Array(3 * count * (EACH + 1));
  let reach = 0;
  for (let f = 0; f < count; f++) {
    const row = (k) => scene.rotations.slice(9 * f + 3 * k, 9 * f + 3 * k + 3);
    const [right, down, forward] = [row(0), row(1), row(2)];
    const place = places.slice(3 * f, 3 * f + 3);
    const at = (x, y, z) => [0, 1, 2].map((k) => place[k] + x * half * aspect * right[k] + y * half * down[k] + z * long * forward[k]);
    const ends = [[-1, -1], [1, -1], [1, 1], [-1, 1]];
    const narrow = kind === "orthographic" ? 1 : 0;
    const lines = [];
    ends.forEach(([x, y], k) => {
      const [nx, ny] = ends[(k + 1) % 4];
      const front = kind === "orthographic" ? 0 : 1;
      lines.push(at(x, y, front), at(nx, ny, front), at(narrow * x, narrow * y, 0), at(x, y, 1));
    });
    vertices.set(lines.flat(), 3 * EACH * f);
    vertices.set(place, 3 * (EACH * count + f));
    reach = Math.max(reach, Math.hypot(...place.map((value, k) => value - scene.middle[k])) + half * Math.max(1, aspect));
  }
  return { vertices, each: EACH, path: EACH * count, every: Math.ceil(count / MOST), reach };
}
