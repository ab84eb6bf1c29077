// The design of a target: its sheet follows the fields, at true scale where asked.
(function () {
  "use strict";
  document.addEventListener("DOMContentLoaded", function () {
    const form = document.getElementById("design"), preview = document.getElementById("preview"), image = preview.querySelector("img");
    const print = document.getElementById("print"), problem = preview.querySelector(".problem"), store = document.getElementById("store");
    if (store) store.hidden = false;
    const DEFAULTS = { charuco: [0.72, "DICT_5X5_250"], aprilgrid: [0.77, "DICT_APRILTAG_36h11"], circles: [0.5, ""], asymmetric_circles: [0.5, ""] };
    const HINTS = { chessboard: "Inner corners, not squares: 9 × 6 inner corners are 10 × 7 squares.", charuco: "Inner corners, not squares: 9 × 6 inner corners are 10 × 7 squares.", circles: "Circles along each side.", asymmetric_circles: "Circles of a row, and rows; every second row is shifted by one pitch.", aprilgrid: "Tags along each side; the pitch is from tag to tag." };
    function adapt(isNew) {
      const kind = form.elements.kind.value;
      for (const part of form.querySelectorAll("[data-for]")) part.hidden = !part.dataset.for.split(" ").includes(kind);
      document.getElementById("count-hint").textContent = HINTS[kind];
      document.getElementById("marker-label").textContent = kind.includes("circles") ? "Diameter, mm" : kind === "aprilgrid" ? "Tag's edge, mm" : "Marker's edge, mm";
      if (isNew) {
        const [share, dictionary] = DEFAULTS[kind] || [0, ""];
        form.elements.marker_mm.value = share ? Number((share * Number(form.elements.pitch_mm.value)).toPrecision(3)) : "";
        form.elements.dictionary.value = dictionary;
      }
    }
    let due = null;
    function update() {
      clearTimeout(due);
      due = setTimeout(async function () {
        const query = new URLSearchParams();
        for (const field of form.elements) if (field.name && field.value && !field.closest("[hidden]")) query.set(field.name, field.value);
        print.href = "/ui/targets/sheet.pdf?" + query;
        try {
          const answer = await fetch("/ui/targets/sheet.svg?" + query, { credentials: "same-origin", headers: { "HX-Request": "true" } });
          if (answer.ok) {
            const before = image.src;
            image.src = URL.createObjectURL(await answer.blob());
            if (before.startsWith("blob:")) URL.revokeObjectURL(before);
            problem.hidden = true;
          } else {
            problem.textContent = gridpose.refusal(await answer.text(), "This target cannot be drawn.").message;
            problem.hidden = false;
          }
        } catch (error) {
          problem.textContent = "The service cannot be reached.";
          problem.hidden = false;
        }
        preview.dataset.shown = query.toString();
      }, 250);
    }
    form.addEventListener("input", update);
    form.elements.kind.addEventListener("change", () => { adapt(true); update(); });
    document.getElementById("true-scale").addEventListener("change", (event) => preview.classList.toggle("true", event.target.checked));
    adapt(false);
    update();
  });
})();
