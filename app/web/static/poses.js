// Commanded poses of a table: read and shown here, stored by the API, and what it refuses said by line.
(function () {
  "use strict";
  const AXES = ["x_mm", "y_mm", "z_mm"], ANGLES = ["roll_deg", "pitch_deg", "yaw_deg"], JOINT = /^j([1-9][0-9]?)_deg$/, SHOWN = 200;
  document.addEventListener("DOMContentLoaded", function () {
    const place = document.getElementById("load-poses");
    if (!place) return;
    place.hidden = false;
    const form = document.getElementById("poses-form"), problem = form.querySelector(".problem"), list = document.getElementById("problems");
    const button = form.querySelector("button"), accept = document.getElementById("accept");
    let poses = [], lines = [], name = "";

    function refuse(text, items = []) {
      problem.textContent = text;
      problem.hidden = !text;
      list.replaceChildren(...items.slice(0, 20).map((one) => Object.assign(document.createElement("li"), { textContent: one })));
      list.hidden = !items.length;
    }
    // Cells of a CSV: quotes, and the delimiter of which the first line has most; numbers may have decimal commas where it is no comma.
    function cellsOf(text) {
      const first = text.split(/\r?\n/, 1)[0], delimiter = [";", "\t", ","].reduce((a, b) => (first.split(b).length > first.split(a).length ? b : a));
      const rows = [[""]];
      let quoted = false;
      for (let k = 0; k < text.length; k++) {
        const one = text[k], row = rows[rows.length - 1];
        if (quoted) {
          if (one !== '"') row[row.length - 1] += one;
          else if (text[k + 1] === '"') { row[row.length - 1] += one; k++; }
          else quoted = false;
        } else if (one === '"') quoted = true;
        else if (one === delimiter) row.push("");
        else if (one === "\n") rows.push([""]);
        else if (one !== "\r") row[row.length - 1] += one;
      }
      return { delimiter, rows: rows.map((row) => row.map((cell) => cell.trim())) };
    }
    function read(text) {
      const { delimiter, rows } = cellsOf(text.replace(/^\uFEFF/, "")), header = rows[0], found = [];
      poses = []; lines = [];
      gridpose.clear(form);
      const unknown = header.filter((name) => name && !["pose_id", "approach", ...AXES, ...ANGLES].includes(name) && !JOINT.test(name));
      show();
      if (!header.includes("pose_id")) return refuse("The table has no column pose_id. Its first line names the columns.");
      if (unknown.length) return refuse("There is no such column: " + unknown.join(", ") + ". Units are part of the names.");
      rows.slice(1).forEach(function (cells, at) {
        if (cells.every((cell) => !cell)) return;
        const line = "Line " + (at + 2), filled = new Map();
        header.forEach((name, k) => { if (name && cells[k]) filled.set(name, cells[k]); });
        const number = function (name) {
          const value = Number(delimiter === "," ? filled.get(name) : filled.get(name).replace(",", "."));
          if (!Number.isFinite(value)) found.push(line + ": " + name + " is not a number: " + filled.get(name));
          return value;
        };
        const pose = { pose_id: filled.get("pose_id") };
        if (!pose.pose_id) found.push(line + ": the pose has no pose_id");
        const axes = AXES.filter((name) => filled.has(name)), joints = [...filled.keys()].filter((name) => JOINT.test(name)).sort((a, b) => a.match(JOINT)[1] - b.match(JOINT)[1]);
        if (axes.length === 3) pose.position_mm = axes.map(number);
        else if (axes.length) found.push(line + ": a coordinate is missing; fill x_mm, y_mm and z_mm, or none");
        for (const name of ANGLES) if (filled.has(name)) pose[name] = number(name);
        if (joints.some((name, k) => Number(name.match(JOINT)[1]) !== k + 1)) found.push(line + ": a joint angle is missing; fill j1_deg to the last, or none");
        else if (joints.length) pose.joint_angles_deg = joints.map(number);
        if (filled.has("approach")) pose.approach = filled.get("approach");
        poses.push(pose);
        lines.push(line);
      });
      if (found.length) { poses = []; refuse(name + " cannot be used.", found); } else refuse(poses.length ? "" : "The table holds no poses: write one line for each under the header.");
      show();
    }
    const text = (value) => (value === undefined ? "–" : String(value).replaceAll("-", "−"));
    function show() {
      document.getElementById("read").hidden = !poses.length;
      button.disabled = !poses.length;
      accept.hidden = true;
      form.elements.accept.checked = false;
      button.textContent = poses.length ? "Store " + poses.length + (poses.length === 1 ? " pose" : " poses") : "Store";
      document.getElementById("read-title").textContent = name + ": " + poses.length + (poses.length === 1 ? " pose was" : " poses were") + " read; nothing is stored yet." + (poses.length > SHOWN ? " The first " + SHOWN + " are shown." : "");
      const joints = Math.max(0, ...poses.map((pose) => (pose.joint_angles_deg || []).length));
      const columns = ["Pose", "x, mm", "y, mm", "z, mm", "Roll, °", "Pitch, °", "Yaw, °", ...Array.from({ length: joints }, (_, k) => "Joint " + (k + 1) + ", °"), "Approach"];
      document.getElementById("read-head").replaceChildren(...columns.map((name) => Object.assign(document.createElement("th"), { scope: "col", textContent: name })));
      document.getElementById("read-rows").replaceChildren(...poses.slice(0, SHOWN).map(function (pose) {
        const row = document.createElement("tr"), name = Object.assign(document.createElement("th"), { scope: "row" });
        name.append(Object.assign(document.createElement("bdi"), { textContent: pose.pose_id }));
        const numbers = [...(pose.position_mm || [,,,]), ...ANGLES.map((angle) => pose[angle]), ...Array.from({ length: joints }, (_, k) => (pose.joint_angles_deg || [])[k])];
        row.append(name, ...[...numbers].map((value) => Object.assign(document.createElement("td"), { className: "num", textContent: text(value) })));
        const last = document.createElement("td");
        last.append(Object.assign(document.createElement("bdi"), { textContent: pose.approach || "–" }));
        row.append(last);
        return row;
      }));
    }
    form.elements.table.addEventListener("change", async function (event) {
      const file = event.target.files[0];
      if (!file) return;
      const bytes = await file.arrayBuffer();
      name = file.name;
      event.target.value = ""; // so that the same file can be chosen again, corrected
      try {
        read(new TextDecoder("utf-8", { fatal: true }).decode(bytes));
      } catch (error) {
        read(new TextDecoder("windows-1252").decode(bytes)); // spreadsheets on Windows
      }
    });
    form.addEventListener("submit", async function (event) {
      event.preventDefault();
      button.disabled = true;
      refuse("");
      gridpose.clear(form);
      try {
        await gridpose.send("POST", "/v1/sessions/" + place.dataset.session + "/poses" + (form.elements.accept.checked ? "?accept_implausible=true" : ""), poses);
        location.reload();
      } catch (error) {
        accept.hidden = error.code !== "implausible_unit";
        for (const item of error.box.querySelectorAll("li")) if (lines[parseInt(item.dataset.field)]) item.prepend(lines[parseInt(item.dataset.field)], ", ");
        gridpose.show(form, error);
        button.disabled = false;
      }
    });
  });
})();
