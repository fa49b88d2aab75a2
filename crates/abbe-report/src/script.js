"use strict";
// On paper all is open; afterwards it is as it was.
let opened = [];
addEventListener("beforeprint", () => {
  opened = [...document.querySelectorAll("details:not([open])")];
  for (const one of opened) one.open = true;
});
addEventListener("afterprint", () => {
  for (const one of opened) one.open = false;
});

// The viewer: points, residuals as arrows, the error field. Where there is no WebGL 2 the plane views are there all the same.
function view(box) {
  const canvas = box.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, preserveDrawingBuffer: true });
  if (!gl) return;
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  const points = new Float32Array(bytes(box.dataset.points)); // x y z, direction, residual, residual over its uncertainty
  const places = new Uint32Array(bytes(box.dataset.places)); // stage, file, line, row
  const field = new Float32Array(bytes(box.dataset.field)); // x y z, error mm
  const names = [...box.querySelectorAll("#names li")].map((one) => one.textContent);
  const count = points.length / 8;
  box.hidden = false;

  const shader = (kind, text) => {
    const made = gl.createShader(kind);
    gl.shaderSource(made, text);
    gl.compileShader(made);
    return made;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `#version 300 es
    in vec3 place; in vec3 colour; uniform mat3 turn; uniform vec3 middle; uniform vec4 zoom; out vec3 shade;
    void main() { vec3 at = turn * (place - middle) * zoom.z;
      gl_Position = vec4(at.x * zoom.x, at.y * zoom.y, -at.z * 0.3, 1.0); gl_PointSize = zoom.w; shade = colour; }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `#version 300 es
    precision mediump float; in vec3 shade; out vec4 shown; void main() { shown = vec4(shade, 1.0); }`));
  gl.linkProgram(program);
  gl.useProgram(program);
  const at = (name) => gl.getUniformLocation(program, name);

  const least = [1e30, 1e30, 1e30], most = [-1e30, -1e30, -1e30];
  const grow = (all, step) => {
    for (let i = 0; i < all.length; i += step)
      for (let k = 0; k < 3; k++) {
        least[k] = Math.min(least[k], all[i + k]);
        most[k] = Math.max(most[k], all[i + k]);
      }
  };
  grow(points, 8);
  grow(field, 6);
  const middle = least.map((one, k) => (one + most[k]) / 2);
  const size = Math.max(1e-6, Math.hypot(...least.map((one, k) => most[k] - one)) / 2);

  let around = -0.6, up = 0.5, zoom = 0.9, picked = -1;
  const turn = () => {
    const [c, s, d, t] = [Math.cos(around), Math.sin(around), Math.cos(up), Math.sin(up)];
    // Columns: where X, Y and Z of the table go; Z stands up.
    return [c, s * t, -s * d, -s, c * t, -c * d, 0, d, t];
  };
  const colour = (name) => {
    const text = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    return [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16) / 255);
  };
  const slider = (name) => {
    const factor = Math.round(10 ** Number(document.getElementById(name).value));
    document.getElementById(name + "-told").textContent = String(factor);
    return factor;
  };
  const draw = (kind, list) => {
    if (!list.length) return;
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(list), gl.DYNAMIC_DRAW);
    for (const [name, from] of [["place", 0], ["colour", 12]]) {
      const where = gl.getAttribLocation(program, name);
      gl.enableVertexAttribArray(where);
      gl.vertexAttribPointer(where, 3, gl.FLOAT, false, 24, from);
    }
    gl.drawArrays(kind, 0, list.length / 6);
  };
  // Lists are made anew when a slider moves, not when the view turns.
  let lists = null;
  const made = () => {
    const [low, high, soft, text] = ["--s0", "--s1", "--soft", "--text"].map(colour);
    const arrows = slider("arrows"), errors = slider("errors");
    const [dots, lines] = [[], []];
    for (let i = 0; i < count; i++) {
      const one = points.subarray(8 * i, 8 * i + 8);
      const shade = one[6] < 0 ? low : high;
      dots.push(one[0], one[1], one[2], ...shade);
      const long = (one[6] / 1000) * arrows;
      lines.push(one[0], one[1], one[2], ...shade);
      lines.push(one[0] + long * one[3], one[1] + long * one[4], one[2] + long * one[5], ...shade);
    }
    for (let i = 0; i < field.length; i += 6) {
      lines.push(field[i], field[i + 1], field[i + 2], ...soft);
      lines.push(...[0, 1, 2].map((k) => field[i + k] + errors * field[i + 3 + k]), ...soft);
    }
    return { dots: new Float32Array(dots), lines: new Float32Array(lines), text };
  };
  const paint = () => {
    const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
    const fine = Math.min(devicePixelRatio || 1, 2);
    canvas.width = wide * fine;
    canvas.height = high * fine;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix3fv(at("turn"), false, turn());
    gl.uniform3fv(at("middle"), middle);
    const scale = (dot) => gl.uniform4f(at("zoom"), Math.min(1, high / wide), Math.min(1, wide / high), zoom / size, dot);
    lists ??= made();
    scale(4 * fine);
    draw(gl.POINTS, lists.dots);
    draw(gl.LINES, lists.lines);
    if (picked >= 0) {
      scale(12 * fine);
      gl.disable(gl.DEPTH_TEST);
      draw(gl.POINTS, [...points.subarray(8 * picked, 8 * picked + 3), ...lists.text]);
    }
  };
  let waiting = false;
  const repaint = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      paint();
    });
  };
  const pick = (index) => {
    if (!(index >= 0 && index < count)) return;
    picked = index;
    const [stage, file, line, row] = places.subarray(4 * index, 4 * index + 4);
    const [residual, over] = points.subarray(8 * index + 6, 8 * index + 8);
    document.getElementById("picked").textContent =
      `${names[file]}:${line} (row ${row}), ${names[stage]}: residual ${residual.toPrecision(4)} µm, ${over.toFixed(1)} of its uncertainty`;
    repaint();
  };
  const pickAt = (x, y) => {
    const t = turn(), [wide, high] = [canvas.clientWidth, canvas.clientHeight];
    let [best, nearest] = [-1, 15 * 15];
    for (let i = 0; i < count; i++) {
      const d = [0, 1, 2].map((k) => points[8 * i + k] - middle[k]);
      const side = (k) => (t[k] * d[0] + t[3 + k] * d[1] + t[6 + k] * d[2]) * (zoom / size) * Math.min(wide, high) / 2;
      const away = (wide / 2 + side(0) - x) ** 2 + (high / 2 - side(1) - y) ** 2;
      if (away < nearest) [best, nearest] = [i, away];
    }
    pick(best);
  };

  let from = null, moved = false;
  canvas.addEventListener("pointerdown", (event) => {
    from = [event.clientX, event.clientY];
    moved = false;
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!from) return;
    const [x, y] = [event.clientX - from[0], event.clientY - from[1]];
    if (!moved && Math.hypot(x, y) < 4) return;
    moved = true;
    from = [event.clientX, event.clientY];
    around += x * 0.01;
    up = Math.max(-1.57, Math.min(1.57, up + y * 0.01));
    repaint();
  });
  canvas.addEventListener("pointerup", (event) => {
    const frame = canvas.getBoundingClientRect();
    if (from && !moved) pickAt(event.clientX - frame.left, event.clientY - frame.top);
    from = null;
  });
  const closer = (by) => {
    zoom = Math.max(0.1, Math.min(50, zoom * by));
    repaint();
  };
  canvas.addEventListener("wheel", (event) => {
    // The page scrolls unless somebody works with the view.
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    closer(Math.exp(-event.deltaY * 0.001));
  }, { passive: false });
  const keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
  canvas.addEventListener("keydown", (event) => {
    if (event.key === "+") return closer(1.2);
    if (event.key === "-") return closer(1 / 1.2);
    const by = keys[event.key];
    if (!by) return;
    event.preventDefault();
    around += by[0];
    up = Math.max(-1.57, Math.min(1.57, up + by[1]));
    repaint();
  });
  for (const name of ["arrows", "errors"])
    document.getElementById(name).addEventListener("input", () => {
      lists = null;
      repaint();
    });
  const order = [...Array(count).keys()].sort((a, b) => Math.abs(points[8 * b + 7]) - Math.abs(points[8 * a + 7]));
  let next = 0;
  document.getElementById("worse").addEventListener("click", () => pick(order[next++ % count]));
  const follow = () => {
    const found = /^#point-([0-9]+)$/.exec(location.hash);
    if (!found) return;
    pick(Number(found[1]));
    box.scrollIntoView();
  };
  addEventListener("hashchange", follow);
  addEventListener("resize", repaint);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    lists = null;
    repaint();
  });
  paint();
  follow();
}
const box = document.getElementById("viewer");
if (box) view(box);
