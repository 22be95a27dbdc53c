// Turns and zooms the 3-D view. The picture is complete without it; see scene.py.
"use strict";
(() => {
  const svg = document.getElementById("scene");
  const tools = document.getElementById("scene-tools");
  if (!svg || !tools) return;
  const numbers = (text) => text.trim().split(/\s+/).map(Number);
  const data = svg.dataset;
  const home = numbers(data.rotation);
  const centre = numbers(data.centre), focus = numbers(data.focus);
  const unit = Number(data.scale), near = Number(data.near);
  const parts = [...svg.querySelectorAll("[data-p]")].map((element) => ({
    element, p: numbers(element.dataset.p), ball: element.querySelector("[data-mm]"),
  }));
  const bar = svg.querySelector(".scale-bar");
  let R = home.slice(), zoom = 1, atRcm = false;

  const times = (A, B) => A.map((_, k) => {
    const i = 3 * Math.floor(k / 3), j = k % 3;
    return A[i] * B[j] + A[i + 1] * B[j + 3] + A[i + 2] * B[j + 6];
  });
  const turn = (dx, dy) => {
    const [a, b, c, d] = [Math.cos(dx), Math.sin(dx), Math.cos(dy), Math.sin(dy)];
    R = times(times([1, 0, 0, 0, c, -d, 0, d, c], [a, 0, b, 0, 1, 0, -b, 0, a]), R);
    draw();
  };

  function draw() {
    const m = atRcm ? focus : centre, s = unit * zoom;
    for (const { element, p, ball } of parts) {
      const flat = [];
      for (let i = 0; i < p.length; i += 3) {
        const [x, y, z] = [p[i] - m[0], p[i + 1] - m[1], p[i + 2] - m[2]];
        flat.push([s * (R[0] * x + R[1] * y + R[2] * z), s * (R[3] * x + R[4] * y + R[5] * z)]);
      }
      if (element.tagName === "polyline") {
        element.setAttribute("points", flat.map((q) => q[0].toFixed(1) + "," + q[1].toFixed(1)).join(" "));
      } else {
        element.setAttribute("transform", `translate(${flat[0][0].toFixed(1)},${flat[0][1].toFixed(1)})`);
      }
      if (ball) ball.setAttribute("r", (s * ball.dataset.mm).toFixed(2));
    }
    svg.classList.toggle("near", zoom >= near);
    svg.classList.toggle("far", zoom < near);
    drawBar(s);
    for (const button of tools.querySelectorAll("[data-zoom]")) {
      const on = Number(button.dataset.zoom) === zoom && (zoom !== 1) === atRcm;
      button.setAttribute("aria-pressed", String(on));
    }
  }

  function drawBar(s) {
    const rough = 60 / s, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].find((f) => f * power >= rough * (1 - 1e-9)) * power;
    const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    bar.querySelector("path").setAttribute("d", `M0,-5V0H${(step * s).toFixed(1)}V-5`);
    bar.querySelector("text").textContent = `${step.toFixed(decimals)} mm`;
  }

  const setZoom = (value, rcm) => { zoom = Math.min(Math.max(value, 0.2), 1e5); atRcm = rcm; draw(); };
  const scaleBy = (factor) => setZoom(zoom * factor, atRcm);
  const reset = () => { R = home.slice(); setZoom(1, false); };

  const actions = {
    in: () => scaleBy(1.5), out: () => scaleBy(1 / 1.5), reset,
    left: () => turn(0.12, 0), right: () => turn(-0.12, 0),
    up: () => turn(0, -0.12), down: () => turn(0, 0.12),
  };
  tools.addEventListener("click", (event) => {
    const button = event.target.closest("button");
    if (!button) return;
    if (button.dataset.zoom) setZoom(Number(button.dataset.zoom), button.dataset.zoom !== "1");
    else actions[button.dataset.action]();
  });

  const keys = {
    ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down",
    "+": "in", "=": "in", "-": "out", 0: "reset",
  };
  svg.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "1") setZoom(1, false);
    else if (event.key === "2") setZoom(100, true);
    else if (keys[event.key]) actions[keys[event.key]]();
    else return;
    event.preventDefault();
  });

  const list = document.getElementById("scene-pose"), told = document.getElementById("scene-picked");
  const ofPoses = [...svg.querySelectorAll("[data-pose]")];
  function pick(pose) {
    for (const element of ofPoses) element.classList.toggle("picked", element.dataset.pose === pose);
    svg.classList.toggle("picking", pose !== "");
    list.value = pose;
    told.replaceChildren();
    if (!pose) return;
    const link = document.createElement("a");
    link.href = `#pose-${pose}`;
    link.textContent = `Pose ${list.selectedOptions[0].text}`;
    told.append(link, `: ${list.selectedOptions[0].dataset.told}`);
  }
  list.addEventListener("change", () => pick(list.value));

  // The pose whose line or dot is nearest to a click, if one is near.
  function nearest(event) {
    const q = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    const at = [q.x - svg.viewBox.baseVal.width / 2, q.y - svg.viewBox.baseVal.height / 2];
    let best = "", least = 9;
    for (const element of ofPoses) {
      const dot = element.tagName === "g";
      if (dot !== svg.classList.contains("near")) continue;
      const ends = dot
        ? [numbers(element.getAttribute("transform").replace(/[^-\d.]+/g, " "))]
        : element.getAttribute("points").split(" ").map((p) => p.split(",").map(Number));
      const away = distance(at, ends[0], ends.at(-1));
      if (away < least) [best, least] = [element.dataset.pose, away];
    }
    return best;
  }
  function distance([x, y], [ax, ay], [bx, by]) {
    const [dx, dy] = [bx - ax, by - ay], long = dx * dx + dy * dy;
    const t = long ? Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / long)) : 0;
    return Math.hypot(x - ax - t * dx, y - ay - t * dy);
  }

  let last = null, start = null;
  svg.addEventListener("pointerdown", (event) => {
    last = start = [event.clientX, event.clientY];
    svg.setPointerCapture(event.pointerId);
  });
  svg.addEventListener("pointermove", (event) => {
    if (!last) return;
    turn((event.clientX - last[0]) * -0.008, (event.clientY - last[1]) * 0.008);
    last = [event.clientX, event.clientY];
  });
  const release = () => { last = null; };
  svg.addEventListener("pointerup", (event) => {
    if (last && Math.hypot(event.clientX - start[0], event.clientY - start[1]) < 4) pick(nearest(event));
    release();
  });
  svg.addEventListener("pointercancel", release);
  // The wheel scrolls the page unless the view was clicked or tabbed to.
  svg.addEventListener("wheel", (event) => {
    if (document.activeElement !== svg) return;
    event.preventDefault();
    scaleBy(Math.exp(-0.0015 * event.deltaY));
  }, { passive: false });

  let before = null;
  window.addEventListener("beforeprint", () => { before = [R, zoom, atRcm]; reset(); });
  window.addEventListener("afterprint", () => {
    if (before) { R = before[0]; setZoom(before[1], before[2]); }
  });
  svg.setAttribute("tabindex", "0");
  tools.hidden = false;
  document.documentElement.classList.add("turning");
  draw();
})();
