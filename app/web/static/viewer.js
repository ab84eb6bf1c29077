// One image at full resolution with what was found in it, as layers; wheel, drag, pinch and keys; neighbours by arrows.
(function () {
  "use strict";
  document.addEventListener("keydown", function (event) {
    if (event.target.matches("input, select, textarea, canvas") || event.altKey || event.ctrlKey || event.metaKey) return;
    const link = event.key === "ArrowLeft" ? document.getElementById("before") : event.key === "ArrowRight" ? document.getElementById("after") : null;
    if (link) { event.preventDefault(); location.assign(link.href); }
  });

  document.addEventListener("DOMContentLoaded", async function () {
    const viewer = document.getElementById("viewer");
    if (!viewer || viewer.dataset.viewable !== "yes") return;
    viewer.querySelector(".loading").hidden = false;
    const image = new Image();
    image.src = viewer.dataset.image;
    let document_;
    try {
      const [answer] = await Promise.all([fetch(viewer.dataset.document, { credentials: "same-origin" }), image.decode()]);
      if (!answer.ok) throw new Error("no document");
      document_ = await answer.json();
    } catch (error) {
      // The original cannot be shown here: what the server draws can.
      const drawn = new Image();
      drawn.src = viewer.dataset.overlay;
      drawn.alt = "The image with what was found in it; the figures are in the tables.";
      viewer.querySelector(".stage").replaceChildren(drawn);
      return;
    }
    const points = document_.points || [], calibration = document_.calibration;
    const stage = viewer.querySelector(".stage"), tools = viewer.querySelector(".tools");
    const canvas = document.createElement("canvas");
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "The image with " + points.length + " grid points. Plus and minus zoom, arrow keys move, zero shows the whole image.");
    stage.replaceChildren(canvas);
    tools.hidden = false;
    const context = canvas.getContext("2d"), width = image.naturalWidth, height = image.naturalHeight;
    const layers = {};
    for (const box of tools.querySelectorAll("[data-layer]")) {
      layers[box.dataset.layer] = box.checked;
      box.addEventListener("change", () => { layers[box.dataset.layer] = box.checked; draw(); });
    }
    const slider = document.getElementById("scale"), output = document.getElementById("scale-text");
    const magnification = () => [1, 2, 5][slider.value % 3] * 10 ** Math.floor(slider.value / 3);
    slider.addEventListener("input", draw);

    let scale = 1, left = 0, top = 0, box = { width: 1, height: 1 };
    const fitted = () => Math.min(box.width / width, box.height / height);
    function fit() { scale = fitted(); left = (box.width - width * scale) / 2; top = (box.height - height * scale) / 2; draw(); }
    function zoom(factor, x = box.width / 2, y = box.height / 2) {
      const next = Math.min(64, Math.max(0.5 * fitted(), scale * factor));
      left = x - (x - left) * next / scale; top = y - (y - top) * next / scale; scale = next;
      draw();
    }
    function resize() {
      const rect = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1, whole = Math.abs(scale - fitted()) < 1e-9;
      box = { width: rect.width, height: rect.height };
      canvas.width = Math.round(rect.width * ratio); canvas.height = Math.round(rect.height * ratio);
      if (whole || scale === 1) fit(); else draw();
    }
    function draw() {
      const ratio = window.devicePixelRatio || 1;
      context.setTransform(1, 0, 0, 1, 0, 0);
      context.fillStyle = "#0b0e12";
      context.fillRect(0, 0, canvas.width, canvas.height);
      context.setTransform(ratio * scale, 0, 0, ratio * scale, ratio * left, ratio * top);
      context.imageSmoothingEnabled = scale < 3;
      context.drawImage(image, 0, 0);
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      // (0, 0) is the middle of the first pixel.
      const at = (u, v) => [left + (u + 0.5) * scale, top + (v + 0.5) * scale];
      const times = magnification();
      output.textContent = String(times);
      for (const point of points) {
        const [x, y] = at(point.u_px, point.v_px);
        const isUsed = point.used !== false;
        if (isUsed && layers.points) { stroke("#4fb6ff", 1.6, () => context.arc(x, y, Math.min(8, Math.max(3, 0.12 * scale * 12)), 0, 7)); }
        if (!isUsed && layers.rejected) stroke("#ff6b5e", 2, () => { context.moveTo(x - 5, y - 5); context.lineTo(x + 5, y + 5); context.moveTo(x + 5, y - 5); context.lineTo(x - 5, y + 5); });
        if (layers.residuals && point.residual_u_px !== null) {
          const dx = point.residual_u_px * times * scale, dy = point.residual_v_px * times * scale;
          stroke("#ffb454", 1.8, () => { context.moveTo(x, y); context.lineTo(x + dx, y + dy); });
        }
      }
      if (layers.axes && calibration) axes(at);
    }
    function stroke(colour, thickness, path) {
      for (const [ink, extra] of [["rgba(0,0,0,.65)", 1.6], [colour, 0]]) { context.beginPath(); path(); context.strokeStyle = ink; context.lineWidth = thickness + extra; context.stroke(); }
    }
    // The target's axes, three grid points long, through the pinhole of this image's camera; distortion moves them by less than their width.
    function axes(at) {
      const camera = calibration.intrinsics, lens = calibration.distortion, T = calibration.T_camera_target;
      const known = points.filter((one) => one.used !== false);
      const project = (p) => {
        const q = [0, 1, 2].map((row) => T[row][0] * p[0] + T[row][1] * p[1] + T[row][2] * p[2] + T[row][3]);
        if (q[2] <= 0) return null;
        const x = q[0] / q[2], y = q[1] / q[2], r = x * x + y * y, radial = 1 + r * ((lens.k1 || 0) + r * ((lens.k2 || 0) + r * (lens.k3 || 0)));
        return at(camera.fx_px * (x * radial + 2 * lens.p1 * x * y + lens.p2 * (r + 2 * x * x)) + camera.cx_px, camera.fy_px * (y * radial + lens.p1 * (r + 2 * y * y) + 2 * lens.p2 * x * y) + camera.cy_px);
      };
      const length = Math.hypot(T[0][3], T[1][3], T[2][3]) * 0.1, origin = project([0, 0, 0]);
      if (!origin || !known.length) return;
      for (const [name, colour, end] of [["x", "#ff7b72", [length, 0, 0]], ["y", "#7ee787", [0, length, 0]], ["z", "#79c0ff", [0, 0, length]]]) {
        const tip = project(end);
        if (!tip) continue;
        stroke(colour, 2.5, () => { context.moveTo(...origin); context.lineTo(...tip); });
        context.font = "bold 15px system-ui, sans-serif";
        context.fillStyle = colour;
        context.fillText(name, tip[0] + 5, tip[1] - 5);
      }
    }

    canvas.addEventListener("wheel", function (event) {
      event.preventDefault();
      const rect = canvas.getBoundingClientRect();
      zoom(Math.exp(-event.deltaY * 0.0016), event.clientX - rect.left, event.clientY - rect.top);
    }, { passive: false });
    const held = new Map();
    canvas.addEventListener("pointerdown", (event) => { held.set(event.pointerId, event); canvas.setPointerCapture(event.pointerId); });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => held.delete(event.pointerId));
    canvas.addEventListener("pointermove", function (event) {
      const before = held.get(event.pointerId);
      if (!before) return;
      const rect = canvas.getBoundingClientRect();
      if (held.size === 2) {
        const other = [...held.values()].find((one) => one.pointerId !== event.pointerId);
        const span = (a, b) => Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY) || 1;
        zoom(span(event, other) / span(before, other), (event.clientX + other.clientX) / 2 - rect.left, (event.clientY + other.clientY) / 2 - rect.top);
      } else { left += event.clientX - before.clientX; top += event.clientY - before.clientY; draw(); }
      held.set(event.pointerId, event);
    });
    canvas.addEventListener("keydown", function (event) {
      const moves = { ArrowLeft: [60, 0], ArrowRight: [-60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] };
      if (event.key === "+" || event.key === "=") zoom(1.4);
      else if (event.key === "-") zoom(1 / 1.4);
      else if (event.key === "0") fit();
      else if (moves[event.key]) { left += moves[event.key][0]; top += moves[event.key][1]; draw(); }
      else return;
      event.preventDefault();
    });
    tools.addEventListener("click", function (event) {
      const way = event.target.dataset.zoom;
      if (way === "in") zoom(1.4);
      if (way === "out") zoom(1 / 1.4);
      if (way === "fit") fit();
      if (way === "full") zoom(1 / (scale * 1));
    });
    const rms = calibration ? calibration.reprojection.rms_px : 0.05;
    slider.value = Math.min(15, Math.max(0, Math.round(3 * Math.log10(0.02 * width / Math.max(rms, 1e-4)))));
    new ResizeObserver(resize).observe(canvas);
    viewer.dataset.ready = "yes";
  });
})();
