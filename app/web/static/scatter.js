// The cycles of a pose about their mean: in 3-D, turned by dragging or keys, or along an axis; one scale for all poses.
(function () {
  "use strict";
  document.addEventListener("DOMContentLoaded", async function () {
    const place = document.getElementById("scatter");
    if (!place) return;
    let poses;
    try {
      const answer = await fetch(place.dataset.points, { credentials: "same-origin" });
      poses = (await answer.json()).poses.filter((pose) => pose.offsets_mm.length > 1);
    } catch (error) {
      return; // the drawings of the server are below
    }
    if (!poses || !poses.length) return;
    place.hidden = false;
    const form = place.querySelector("form"), canvas = place.querySelector("canvas"), context = canvas.getContext("2d");
    const chooser = form.elements.pose, output = place.querySelector("output"), body = place.querySelector("tbody");
    for (const pose of poses) chooser.add(new Option(pose.pose_id + " (n = " + pose.cycles.length + ")", pose.pose_id));
    let yaw = 0.6, pitch = 0.5, zoom = 1, size = { width: 720, height: 446 };
    const reach = (pose) => {
      // However it is turned: points by their distance, ellipsoids by a bound of their longest axis.
      const inside = pose.offsets_mm.filter((_, at) => !pose.outlier[at]).map((one) => Math.hypot(...one));
      const longest = (one) => one ? 3 * Math.sqrt(Math.max(...one.map((row) => row.reduce((sum, value) => sum + Math.abs(value), 0)))) : 0;
      return Math.max(1e-6, ...inside, longest(pose.observed_mm2), longest(pose.noise_mm2));
    };
    const common = Math.max(...poses.map(reach));
    const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    const digits = (value, count = 3) => Number(value.toPrecision(count)).toString().replace("-", "−");

    function basis() {
      const view = form.elements.view.value;
      if (view === "xy") return [[1, 0, 0], [0, 1, 0]];
      if (view === "xz") return [[1, 0, 0], [0, 0, 1]];
      if (view === "yz") return [[0, 1, 0], [0, 0, 1]];
      const [c, s, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
      return [[c, s, 0], [-s * sp, c * sp, cp]];
    }
    function draw() {
      const pose = poses.find((one) => one.pose_id === chooser.value) || poses[0];
      const half = (form.elements.common.checked ? common : reach(pose)) * 1.12;
      const [right, up] = basis();
      const { width, height } = size, pixels = zoom * Math.max(0, Math.min(width, height) / 2 - 46) / half;
      const at = (p) => [width / 2 + pixels * dot(right, p), height / 2 - 8 - pixels * dot(up, p)];
      const [ink, quiet, line] = [colour("--cycle"), colour("--quiet"), colour("--line")];
      context.clearRect(0, 0, width, height);
      context.font = "15px system-ui, sans-serif";
      const step = nice(half / zoom / 2.5), unit = step < 0.1 ? ["µm", 1000] : ["mm", 1];
      // A scale bar, and the axes with their names.
      [[1, 0, 0], [0, 1, 0], [0, 0, 1]].forEach(function (axis, k) {
        const long = 0.92 * half, a = at(axis.map((v) => -v * long)), b = at(axis.map((v) => v * long));
        if (Math.hypot(a[0] - b[0], a[1] - b[1]) < 12) return;
        path(line, 1.5, () => { context.moveTo(...a); context.lineTo(...b); });
        context.fillStyle = quiet;
        for (let mark = -Math.floor(long / step); mark <= long / step; mark++) {
          if (!mark) continue;
          const p = at(axis.map((v) => v * mark * step));
          context.fillRect(p[0] - 1.5, p[1] - 1.5, 3, 3);
        }
        context.fillText("xyz"[k], b[0] + 6, b[1] - 4);
      });
      const bar = step * pixels;
      path(quiet, 2, () => { context.moveTo(24, height - 24); context.lineTo(24 + bar, height - 24); context.moveTo(24, height - 29); context.lineTo(24, height - 19); context.moveTo(24 + bar, height - 29); context.lineTo(24 + bar, height - 19); });
      context.fillStyle = quiet;
      context.fillText(digits(step * unit[1], 2) + " " + unit[0] + " between marks", 24, height - 34);
      ellipse(pose.observed_mm2, colour("--observed"), right, up, pixels, width / 2, height / 2 - 8, []);
      ellipse(pose.noise_mm2, colour("--noise"), right, up, pixels, width / 2, height / 2 - 8, [7, 5]);
      pose.offsets_mm.forEach(function (offset, k) {
        const [x, y] = at(offset);
        if (pose.outlier[k]) path(colour("--outlier"), 2.5, () => { context.moveTo(x - 6, y - 6); context.lineTo(x + 6, y + 6); context.moveTo(x + 6, y - 6); context.lineTo(x - 6, y + 6); });
        else { context.beginPath(); context.arc(x, y, 4, 0, 7); context.fillStyle = ink; context.fill(); }
        if (form.elements.numbers.checked && pose.cycles[k] !== null) { context.fillStyle = ink; context.fillText(pose.cycles[k], x + 7, y - 5); }
      });
      output.textContent = "frame ± " + digits(half / zoom * unit[1], 2) + " " + unit[0];
      // Three digits of the largest offset: more say nothing of a cycle.
      const largest = Math.max(...pose.offsets_mm.map((offset) => Math.hypot(...offset)), 1e-9), decimals = Math.min(6, Math.max(0, 2 - Math.floor(Math.log10(largest))));
      body.replaceChildren(...pose.offsets_mm.map(function (offset, k) {
        const row = document.createElement("tr");
        const cells = [pose.cycles[k] === null ? "–" : String(pose.cycles[k]), ...offset.map((v) => fixed(v, decimals)), fixed(Math.hypot(...offset), decimals) + (pose.outlier[k] ? " outlier" : "")];
        cells.forEach(function (text, column) {
          const cell = document.createElement(column ? "td" : "th");
          if (!column) cell.scope = "row"; else cell.className = "num";
          cell.textContent = text;
          row.append(cell);
        });
        return row;
      }));
    }
    const fixed = (value, decimals) => { const text = value.toFixed(decimals); return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−"); };
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const nice = (value) => { const power = Math.pow(10, Math.floor(Math.log10(value))), share = value / power; return power * (share >= 5 ? 5 : share >= 2 ? 2 : 1); };
    function path(ink, thickness, trace, dash = []) { context.beginPath(); context.setLineDash(dash); trace(); context.strokeStyle = ink; context.lineWidth = thickness; context.stroke(); context.setLineDash([]); }
    // The outline of an ellipsoid of 3 standard deviations, seen along the view: the ellipse of the projected covariance.
    function ellipse(covariance, ink, right, up, pixels, x, y, dash) {
      if (!covariance) return;
      const along = (a, b) => dot(a, covariance.map((row) => dot(row, b)));
      const [p, q, r] = [along(right, right), along(right, up), along(up, up)];
      const mean = (p + r) / 2, part = Math.hypot((p - r) / 2, q);
      const radii = [mean + part, Math.max(0, mean - part)].map((value) => 3 * Math.sqrt(Math.max(0, value)) * pixels);
      path(ink, 2, () => context.ellipse(x, y, radii[0], radii[1], -Math.atan2(2 * q, p - r) / 2, 0, 7), dash);
    }
    const turn = (a, b) => { form.elements.view.value = "turn"; yaw += a; pitch = Math.min(1.57, Math.max(-1.57, pitch + b)); draw(); };
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => { if (event.buttons) turn(-event.movementX * 0.01, event.movementY * 0.01); });
    canvas.addEventListener("keydown", function (event) {
      const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
      if (turns[event.key]) turn(...turns[event.key]);
      else if (event.key === "+" || event.key === "=") { zoom *= 1.25; draw(); }
      else if (event.key === "-") { zoom /= 1.25; draw(); }
      else return;
      event.preventDefault();
    });
    form.addEventListener("change", () => { zoom = 1; draw(); });
    form.addEventListener("submit", (event) => event.preventDefault());
    document.addEventListener("gridpose:theme", draw);
    matchMedia("print").addEventListener("change", draw); // paper is white
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    // As many pixels as the screen shows, so that letters keep their size.
    function resize() {
      const width = Math.round(canvas.getBoundingClientRect().width) || 720, ratio = window.devicePixelRatio || 1;
      size = { width, height: Math.round(width * (width < 600 ? 0.85 : 0.62)) };
      canvas.width = width * ratio; canvas.height = size.height * ratio;
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      draw();
    }
    addEventListener("resize", resize);
    resize();
    place.dataset.ready = "yes";
  });
})();
