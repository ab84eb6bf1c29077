// A session's page, live: counts by server-sent events, the images shortly after, and corrections of those selected.
(function () {
  "use strict";
  const REFRESH_MS = 700;
  const live = document.getElementById("live");
  const connection = document.getElementById("connection");
  const number = new Intl.NumberFormat("en").format;
  const grouped = (value) => number(value).replaceAll(",", "\u202f");
  let source = null, lost = false, due = null, ended = false, selection = new Set();

  function show(counts) {
    const done = counts.succeeded + counts.failed, all = done + counts.queued + counts.running;
    const set = (name, value) => { for (const one of document.querySelectorAll(".count-" + name)) one.textContent = grouped(value); };
    set("done", done); set("all", all); set("succeeded", counts.succeeded); set("failed", counts.failed); set("waiting", counts.queued + counts.running);
    const bar = document.querySelector("#progress progress");
    bar.max = all || 1;
    bar.value = done;
  }

  // The images, at most every REFRESH_MS, and not under the hands of someone who selects.
  function refresh() {
    if (due) return;
    due = setTimeout(function () {
      due = null;
      if (selection.size || document.querySelector("dialog[open]")) return;
      const gallery = document.getElementById("gallery");
      if (gallery.contains(document.activeElement) && document.activeElement.matches("select, input")) return void refresh();
      const focused = document.activeElement && document.activeElement.closest(".tile");
      const id = focused && focused.dataset.id;
      htmx.ajax("GET", gallery.dataset.address, { target: "#gallery", swap: "outerHTML" }).then(function () {
        const again = id && document.querySelector('.tile[data-id="' + id + '"] a');
        if (again) again.focus({ preventScroll: true });
      });
    }, REFRESH_MS);
  }

  // Next views that are open, as soon as all images are computed: one question at a time.
  let asking = false, askAgain = false;
  async function renewViews() {
    const place = document.querySelector("#next-views[data-live][open] [data-next-view]");
    if (!place) return;
    if (asking) return void (askAgain = true);
    asking = true;
    try {
      await htmx.ajax("GET", place.dataset.nextView, { target: "#next-view" });
    } finally {
      asking = false;
      if (askAgain) { askAgain = false; renewViews(); }
    }
  }

  function follow() {
    source = new EventSource(live.dataset.events);
    source.addEventListener("open", function () {
      connection.textContent = lost ? "Connected again; the images are up to date." : "";
      if (lost) { gridpose.notice(""); refresh(); }
      lost = false;
    });
    let last = null;
    function renew(event) {
      const counts = JSON.parse(event.data).counts, text = JSON.stringify(counts);
      const isChange = event.type === "measurement" || text !== (last === null ? initial() : last);
      if (isChange) refresh();
      if (last !== null && last !== text && !counts.queued && !counts.running) renewViews();
      last = text;
      show(counts);
    }
    source.addEventListener("progress", renew);
    source.addEventListener("measurement", renew);
    source.addEventListener("deleted", function () {
      ended = true;
      source.close();
      gridpose.notice("This session was deleted.", "All sessions", "/ui/");
    });
    source.addEventListener("error", function () {
      if (ended) return;
      lost = true;
      connection.textContent = "The connection is lost; trying again.";
      if (source.readyState === EventSource.CLOSED) setTimeout(reopen, 2000);
    });
  }

  const initial = () => {
    const seen = document.getElementById("progress").dataset;
    return JSON.stringify({ queued: +seen.queued, running: +seen.running, succeeded: +seen.succeeded, failed: +seen.failed, duplicates: NaN }).replace("null", "0");
  };

  // The browser gives up where the answer is no event stream: find out why.
  async function reopen() {
    try {
      const answer = await fetch("/v1/sessions/" + live.dataset.session, { credentials: "same-origin" });
      if (answer.status === 401) {
        ended = true;
        connection.textContent = "";
        return gridpose.notice("You are signed out: the key expired or was revoked.", "Sign in", "/ui/sign-in?next=" + encodeURIComponent(location.pathname));
      }
      if (answer.status === 404) return gridpose.notice("This session was deleted.", "All sessions", "/ui/");
    } catch (error) {
      return void setTimeout(reopen, 2000);
    }
    follow();
  }

  // Selection and corrections.
  const picks = () => [...document.querySelectorAll(".pick")];
  function prepare() {
    const bar = document.getElementById("selection");
    for (const one of picks()) {
      one.hidden = false;
      if (selection.has(one.closest(".tile").dataset.id)) one.checked = true; // ticked while the images were on their way
    }
    if (bar) bar.hidden = false;
    showSelection();
  }
  function showSelection() {
    selection = new Set(picks().filter((one) => one.checked).map((one) => one.closest(".tile").dataset.id));
    const text = document.getElementById("selected");
    if (!text) return;
    text.textContent = selection.size ? selection.size + " selected" : "none selected";
    for (const button of document.querySelectorAll("[data-act]")) button.disabled = !selection.size;
    const all = document.getElementById("select-all");
    all.checked = selection.size > 0 && selection.size === picks().length;
    all.indeterminate = selection.size > 0 && !all.checked;
  }
  document.addEventListener("change", function (event) {
    if (event.target.id === "select-all") for (const one of picks()) one.checked = event.target.checked;
    if (event.target.matches(".pick, #select-all")) showSelection();
  });

  // Each of the selected images; the first refusal stops, and what was done stays done.
  async function correct(method, tail, body, form) {
    let done = 0;
    const ids = [...selection];
    for (const id of ids) {
      try {
        await gridpose.send(method, "/v1/measurements/" + id + tail, body);
        done += 1;
      } catch (error) {
        const tally = done + " of " + ids.length + " were changed.";
        if (!form) gridpose.notice(error.message + " " + tally);
        else {
          error.box.append(Object.assign(document.createElement("p"), { textContent: tally }));
          gridpose.show(form, error);
        }
        return false;
      }
    }
    for (const one of picks()) one.checked = false;
    selection = new Set();
    refresh();
    return true;
  }
  function ask(id, then) {
    const dialog = document.getElementById(id), form = dialog.querySelector("form");
    form.reset();
    gridpose.clear(form);
    form.onsubmit = async function (event) {
      event.preventDefault();
      if (await then(form)) { dialog.close(); refresh(); }
    };
    dialog.showModal();
  }
  document.addEventListener("click", function (event) {
    const act = event.target.closest("[data-act]");
    if (!act || act.disabled) return;
    if (act.dataset.act === "exclude") ask("exclude-dialog", (form) => correct("PATCH", "", gridpose.body(form), form));
    if (act.dataset.act === "include") correct("PATCH", "", { excluded: null });
    if (act.dataset.act === "retry") correct("POST", "/retry");
    if (act.dataset.act === "correct") ask("correct-dialog", function (form) {
      const body = gridpose.body(form);
      if (Object.keys(body).length) return correct("PATCH", "", body, form);
      gridpose.show(form, gridpose.refusal("", "Enter a pose, a cycle, an image of the stop or a focus group."));
      return false;
    });
  });

  // The link that was followed is gone with the page that it was on: the same one of the next page, or the images.
  let followed = null;
  document.addEventListener("htmx:beforeSwap", function () {
    const link = document.activeElement && document.activeElement.closest("#gallery .paging a");
    followed = link && link.rel;
  });
  document.addEventListener("htmx:afterSwap", function () {
    const gallery = document.getElementById("gallery");
    if (followed) (gallery.querySelector('.paging a[rel="' + followed + '"]') || gallery).focus({ preventScroll: true });
    followed = null;
    const weak = document.getElementById("gallery").dataset.weak;
    document.getElementById("count-weak").textContent = weak ? " (" + weak + " weak)" : "";
    prepare();
  });
  document.addEventListener("DOMContentLoaded", function () { prepare(); follow(); });
  window.addEventListener("pagehide", () => source && source.close());
  window.addEventListener("pageshow", (event) => event.persisted && follow());
})();
