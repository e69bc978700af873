"use strict";
// The 3-D view: points or mesh in WebGL 2, turned about the object's middle. Numbers come as text blocks in the page.
(() => {
  const viewer = document.getElementById("viewer");
  if (!viewer) return;
  const canvas = viewer.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: true });
  if (!gl) return;

  const scene = JSON.parse(document.getElementById("viewer-scene").textContent);
  const bytes = (name) => {
    const block = document.getElementById("viewer-" + name);
    if (!block) return null;
    const text = atob(block.textContent.trim());
    const out = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
    return out;
  };

  const COMMON = `#version 300 es
    precision highp float;`;
  const SURFACE_VERTEX = COMMON + `
    in vec4 place; in vec2 octahedral;
    uniform mat4 clipFromWorld; uniform vec3 low, high; uniform float pointSize, pointScale;
    out vec3 normal, world; out float sd;
    void main() {
      world = mix(low, high, place.xyz);
      vec3 n = vec3(octahedral, 1.0 - abs(octahedral.x) - abs(octahedral.y));
      float fold = max(-n.z, 0.0);
      n.xy -= sign(n.xy) * fold;
      normal = normalize(n);
      sd = place.w;
      gl_Position = clipFromWorld * vec4(world, 1.0);
      gl_PointSize = clamp(pointSize * pointScale / gl_Position.w, 1.0, 24.0);
    }`;
  const SURFACE_FRAGMENT = COMMON + `
    in vec3 normal, world; in float sd;
    uniform int colourBy; uniform bool round; uniform vec3 eye, depthStops[16], sdStops[16]; uniform vec2 depthLimits;
    out vec4 colour;
    vec3 ramp(vec3 stops[16], float t) {
      float at = clamp(t, 0.0, 1.0) * 15.0;
      int k = int(min(floor(at), 14.0));
      return mix(stops[k], stops[k + 1], at - float(k));
    }
    void main() {
      if (round && length(gl_PointCoord - 0.5) > 0.5) discard;
      vec3 n = normalize(normal);
      float light = 0.35 + 0.65 * abs(dot(n, normalize(eye - world)));
      if (colourBy == 0) colour = vec4(ramp(depthStops, (world.z - depthLimits.x) / (depthLimits.y - depthLimits.x)) * light, 1.0);
      else if (colourBy == 1) colour = vec4(0.5 + 0.5 * n * vec3(1.0, 1.0, -1.0), 1.0);
      else if (colourBy == 2) colour = vec4(ramp(sdStops, sd), 1.0);
      else colour = vec4(vec3(0.66, 0.72, 0.76) * light, 1.0);
    }`;
  const LINE_VERTEX = COMMON + `
    in vec3 position; uniform mat4 clipFromWorld;
    void main() { gl_Position = clipFromWorld * vec4(position, 1.0); }`;
  const LINE_FRAGMENT = COMMON + `
    uniform vec4 ink; out vec4 colour;
    void main() { colour = ink; }`;

  const program = (vertex, fragment) => {
    const made = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
    return { made, at: (name) => gl.getUniformLocation(made, name) };
  };
  const buffer = (data, target = gl.ARRAY_BUFFER) => {
    const made = gl.createBuffer();
    gl.bindBuffer(target, made);
    gl.bufferData(target, data, gl.STATIC_DRAW);
    return made;
  };
  const surface = program(SURFACE_VERTEX, SURFACE_FRAGMENT);
  const lines = program(LINE_VERTEX, LINE_FRAGMENT);

  const load = (name) => {
    const place = bytes(name + "-place");
    if (!place) return null;
    const vertexArray = gl.createVertexArray();
    gl.bindVertexArray(vertexArray);
    buffer(place);
    const placeAt = gl.getAttribLocation(surface.made, "place");
    gl.enableVertexAttribArray(placeAt);
    gl.vertexAttribPointer(placeAt, 4, gl.UNSIGNED_SHORT, true, 8, 0);
    buffer(bytes(name + "-normal"));
    const normalAt = gl.getAttribLocation(surface.made, "octahedral");
    gl.enableVertexAttribArray(normalAt);
    gl.vertexAttribPointer(normalAt, 2, gl.BYTE, true, 2, 0);
    const count = place.length / 8;
    const face = bytes(name + "-face");
    if (face) buffer(face, gl.ELEMENT_ARRAY_BUFFER);
    const wide = count > 65535;
    return { vertexArray, count, indices: face ? face.length / (wide ? 4 : 2) : 0, type: wide ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT };
  };
  const things = { points: load("points"), mesh: load("mesh") };

  const screenLines = new Float32Array(scene.screens.flatMap((corners) => corners.flatMap((corner, k) => [...corner, ...corners[(k + 1) % 4]])));
  const screenArray = gl.createVertexArray();
  gl.bindVertexArray(screenArray);
  buffer(screenLines);
  const positionAt = gl.getAttribLocation(lines.made, "position");
  gl.enableVertexAttribArray(positionAt);
  gl.vertexAttribPointer(positionAt, 3, gl.FLOAT, false, 12, 0);
  gl.bindVertexArray(null);

  // Vectors and the matrix from world to clip space, by columns.
  const minus = (a, b) => a.map((value, k) => value - b[k]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const size = Math.hypot(...a); return a.map((value) => value / size); };

  const FIELD = 28 * Math.PI / 180;
  const middle = scene.low.map((value, k) => (value + scene.high[k]) / 2);
  const radius = Math.max(Math.hypot(...minus(scene.high, scene.low)) / 2, 1e-6);
  const tangent = Math.tan(FIELD / 2);
  const aspect = () => canvas.clientWidth / Math.max(canvas.clientHeight, 1);
  const directions = (azimuth, elevation) => {
    const a = azimuth * Math.PI / 180, e = elevation * Math.PI / 180;
    const back = [Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)];
    const right = [Math.cos(a), 0, -Math.sin(a)];
    return { back, right, up: cross(back, right) };
  };
  const boxCorners = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [k & 1, k & 2, k & 4].map((bit, axis) => (bit ? scene.high : scene.low)[axis]));
  // The view along a direction that just holds the given points.
  const fitted = (azimuth, elevation, points = boxCorners) => {
    const { back, right, up } = directions(azimuth, elevation);
    const across = tangent * Math.max(aspect(), 1), high = tangent / Math.min(aspect(), 1);
    let distance = 0;
    for (const corner of points) {
      const from = minus(corner, middle);
      distance = Math.max(distance, dot(back, from) + 1.04 * Math.max(Math.abs(dot(right, from)) / across, Math.abs(dot(up, from)) / high));
    }
    return { azimuth, elevation, distance, target: [...middle] };
  };
  const first = () => fitted(scene.azimuth, scene.elevation);
  let view = null;
  const show = { what: "points", colour: "depth", screens: false, size: 3 };

  const axes = () => {
    const { back, right, up } = directions(view.azimuth, view.elevation);
    return { back, right, up, eye: view.target.map((value, k) => value + view.distance * back[k]) };
  };
  const clipFromWorld = (frame) => {
    const near = view.distance / 100, far = view.distance * 20 + 20 * radius;
    const { right, up, back, eye } = frame;
    // The field of view belongs to the shorter side of the window.
    const fx = 1 / (tangent * Math.max(aspect(), 1)), fy = Math.min(aspect(), 1) / tangent;
    const z = (far + near) / (near - far), w = 2 * far * near / (near - far);
    const out = new Float32Array(16);
    for (let k = 0; k < 3; k++) {
      out[4 * k] = fx * right[k];
      out[4 * k + 1] = fy * up[k];
      out[4 * k + 2] = z * back[k];
      out[4 * k + 3] = -back[k];
    }
    out[12] = -fx * dot(right, eye);
    out[13] = -fy * dot(up, eye);
    out[14] = -z * dot(back, eye) + w;
    out[15] = dot(back, eye);
    return out;
  };

  // Points start just large enough to close the surface: some times their mean spacing on the screen.
  let startDistance = 1;
  const sizer = viewer.querySelector("[data-size]");
  const start = () => {
    view = first();
    startDistance = view.distance;
    const { right, up } = directions(view.azimuth, view.elevation);
    const extent = (axis) => { const at = boxCorners.map((corner) => dot(axis, corner)); return Math.max(...at) - Math.min(...at); };
    const perUnit = Math.min(canvas.clientWidth, canvas.clientHeight) / (2 * tangent * view.distance);
    const spacing = perUnit * Math.sqrt(extent(right) * extent(up) / Math.max(things.points.count, 1));
    show.size = Math.max(1, Math.min(8, Math.round(2 * 2.4 * spacing) / 2));
    sizer.value = show.size;
  };

  const CODES = { depth: 0, normal: 1, sd: 2, plain: 3 };
  const draw = () => {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height) return;
    if (!view) start();
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const frame = axes(), matrix = clipFromWorld(frame);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const thing = things[show.what];
    gl.useProgram(surface.made);
    gl.uniformMatrix4fv(surface.at("clipFromWorld"), false, matrix);
    gl.uniform3fv(surface.at("low"), scene.low);
    gl.uniform3fv(surface.at("high"), scene.high);
    gl.uniform3fv(surface.at("eye"), frame.eye);
    gl.uniform1f(surface.at("pointSize"), show.size * ratio);
    gl.uniform1f(surface.at("pointScale"), startDistance);
    gl.uniform1i(surface.at("colourBy"), CODES[show.colour]);
    gl.uniform1i(surface.at("round"), show.what === "points" ? 1 : 0);
    gl.uniform2f(surface.at("depthLimits"), scene.depth.low, scene.depth.high);
    gl.uniform3fv(surface.at("depthStops"), scene.depth.stops.flat());
    gl.uniform3fv(surface.at("sdStops"), (scene.sd || scene.depth).stops.flat());
    gl.bindVertexArray(thing.vertexArray);
    if (show.what === "mesh") gl.drawElements(gl.TRIANGLES, thing.indices, thing.type, 0);
    else gl.drawArrays(gl.POINTS, 0, thing.count);
    if (show.screens) {
      const ink = getComputedStyle(canvas).color.match(/[\d.]+/g).map((part) => part / 255);
      gl.useProgram(lines.made);
      gl.uniformMatrix4fv(lines.at("clipFromWorld"), false, matrix);
      gl.uniform4f(lines.at("ink"), ink[0], ink[1], ink[2], 1);
      gl.bindVertexArray(screenArray);
      gl.drawArrays(gl.LINES, 0, screenLines.length / 3);
    }
    gl.bindVertexArray(null);
    triad(frame);
    scalebar();
    viewer.dataset.drawn = show.what;
  };
  let asked = false;
  const redraw = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => { asked = false; draw(); });
  };

  // The small axes in the corner: x right, y up, z towards the camera.
  const triadSvg = viewer.querySelector(".triad");
  const SVG = "http://www.w3.org/2000/svg";
  const arms = ["x", "y", "z"].map((name) => {
    const arm = document.createElementNS(SVG, "path"), label = document.createElementNS(SVG, "text");
    arm.setAttribute("class", "arm " + name);
    label.textContent = name;
    triadSvg.append(arm, label);
    return { arm, label };
  });
  const triad = ({ right, up }) => arms.forEach(({ arm, label }, k) => {
    const x = 18 * right[k], y = -18 * up[k];
    arm.setAttribute("d", `M0 0L${x.toFixed(2)} ${y.toFixed(2)}`);
    label.setAttribute("x", (1.35 * x).toFixed(2));
    label.setAttribute("y", (1.35 * y + 3.5).toFixed(2));
  });

  // A bar of a round length, true at the distance of the middle.
  const bar = viewer.querySelector(".scalebar");
  const scalebar = () => {
    const across = 2 * view.distance * tangent * Math.max(aspect(), 1);
    const perUnit = canvas.clientWidth / across, wanted = 110 / perUnit, power = 10 ** Math.floor(Math.log10(wanted));
    const length = [5, 2, 1].map((step) => step * power).find((step) => step <= wanted);
    bar.firstElementChild.style.width = `${(length * perUnit).toFixed(1)}px`;
    bar.lastElementChild.textContent = `${Number(length.toPrecision(1))} ${scene.unit}`;
  };

  const legend = viewer.querySelector(".legend");
  const relabel = () => {
    const ramp = { depth: scene.depth, sd: scene.sd }[show.colour];
    legend.replaceChildren();
    legend.hidden = !ramp;
    if (!ramp) return;
    const strip = document.createElement("i"), low = document.createElement("span"), high = document.createElement("span");
    strip.style.background = `linear-gradient(90deg, ${ramp.stops.map((stop) => `rgb(${stop.map((part) => Math.round(255 * part)).join(" ")})`).join(", ")})`;
    low.textContent = `${show.colour} ${ramp.low_text}`;
    high.textContent = ramp.high_text;
    legend.append(low, strip, high);
  };

  // Turn, move, zoom.
  const turn = (dx, dy) => {
    view.azimuth -= dx;
    view.elevation = Math.max(-89, Math.min(89, view.elevation + dy));
    redraw();
  };
  const move = (dx, dy) => {
    const { right, up } = axes();
    const perPx = 2 * view.distance * tangent / Math.min(canvas.clientHeight, canvas.clientWidth);
    view.target = view.target.map((value, k) => value - perPx * (dx * right[k] - dy * up[k]));
    redraw();
  };
  const zoom = (factor) => {
    view.distance = Math.max(radius / 50, Math.min(60 * radius, view.distance * factor));
    redraw();
  };
  const fingers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.focus({ preventScroll: true });
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before[0], dy = event.clientY - before[1];
    const others = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
    if (others.length) {
      const apart = (place) => Math.hypot(place[0] - others[0][0], place[1] - others[0][1]);
      const now = apart([event.clientX, event.clientY]);
      if (now > 4) zoom(apart(before) / now);
      move(dx / 2, dy / 2);
    } else if (event.buttons & 2 || event.shiftKey) move(dx, dy);
    else turn(0.45 * dx, 0.45 * dy);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  // The page scrolls under the wheel until the view has been clicked.
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    zoom(Math.exp(0.0012 * event.deltaY));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (step) event.shiftKey ? move(24 * step[0], 24 * step[1]) : turn(6 * step[0], 6 * step[1]);
    else if (event.key === "+" || event.key === "=") zoom(0.85);
    else if (event.key === "-") zoom(1 / 0.85);
    else if (event.key === "0") { view = fitted(scene.azimuth, scene.elevation, shownCorners()); redraw(); }
    else if (event.key === "Escape") { canvas.blur(); return; }
    else return;
    event.preventDefault();
  });

  const shownCorners = () => show.screens ? [...boxCorners, ...scene.screens.flat()] : boxCorners;
  const press = (name, value) => {
    for (const button of viewer.querySelectorAll(`[data-${name}]`)) button.setAttribute("aria-pressed", String(button.dataset[name] === value));
  };
  const VIEWS = { first: [scene.azimuth, scene.elevation], display: [180, 0], camera: [0, 0], side: [90, 0], above: [180, 89] };
  viewer.querySelector(".controls").addEventListener("click", (event) => {
    const button = event.target.closest("button");
    if (!button) return;
    const { show: what, colour, view: from } = button.dataset;
    if (what) { show.what = what; press("show", what); }
    if (colour) { show.colour = colour; press("colour", colour); relabel(); }
    if (from) view = fitted(...VIEWS[from], shownCorners());
    if ("save" in button.dataset) {
      draw();
      const link = document.createElement("a");
      link.href = canvas.toDataURL("image/png");
      link.download = "surface.png";
      link.click();
    }
    redraw();
  });
  viewer.querySelector("[data-toggle=screens]").addEventListener("change", (event) => {
    show.screens = event.target.checked;
    view = fitted(view.azimuth, view.elevation, shownCorners());
    redraw();
  });
  sizer.addEventListener("input", (event) => { show.size = Number(event.target.value); redraw(); });

  viewer.querySelector("[data-show=mesh]").disabled = !things.mesh;
  viewer.querySelector("[data-colour=sd]").disabled = !scene.sd;
  viewer.querySelector(".controls").hidden = false;
  viewer.classList.add("live");
  canvas.addEventListener("webglcontextlost", () => viewer.classList.remove("live"));
  // On paper, the view as it was turned.
  const still = viewer.querySelector(".still");
  addEventListener("beforeprint", () => {
    if (!viewer.classList.contains("live")) return;
    draw();
    still.src = canvas.toDataURL("image/png");
    still.width = canvas.width;
    still.height = canvas.height;
  });
  document.addEventListener("themechange", redraw);
  new ResizeObserver(redraw).observe(canvas);
  relabel();
  draw();
})();
