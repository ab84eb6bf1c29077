// Before the page is drawn: the reader's choice of light or dark, where it differs from the system's.
(function () {
  "use strict";
  try {
    const chosen = localStorage.getItem("gridpose-theme");
    if (chosen === "light" || chosen === "dark") document.documentElement.dataset.theme = chosen;
  } catch (error) {
    // Storage is off in this browser: the system's choice holds.
  }
})();
