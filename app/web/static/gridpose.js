// What all pages share: requests with the CSRF token, forms that send JSON, copying, local times, light and dark.
(function () {
  "use strict";
  const gridpose = (window.gridpose = {});
  const csrf = () => document.querySelector('meta[name="csrf-token"]').content;

  // A refusal to throw and to show: the fragment that the service answers, or one with a text of ours, of a field where it is of one.
  gridpose.refusal = function (html, text, rest = {}) {
    let box = new DOMParser().parseFromString(html, "text/html").querySelector(".refusal");
    if (!box) {
      box = Object.assign(document.createElement("div"), { className: "refusal" });
      box.setAttribute("role", "alert");
      const item = box.appendChild(document.createElement(rest.field ? "li" : "p"));
      if (rest.field) item.dataset.field = rest.field;
      item.append(...(rest.field ? [document.createElement("b"), ": "] : []), text);
    }
    const message = [...box.querySelectorAll("p:not(.code), li")].map((one) => one.textContent.trim()).join(" ");
    return Object.assign(new Error(message), { box, code: box.dataset.code, ...rest });
  };

  // Send a request to the API; what it refuses is thrown as it is shown.
  gridpose.send = async function (method, address, body, headers = {}) {
    const options = { method, headers: { "X-CSRF-Token": csrf(), "HX-Request": "true", Accept: "application/json", ...headers }, credentials: "same-origin" };
    if (body !== undefined) {
      options.body = body instanceof Blob ? body : JSON.stringify(body);
      if (!(body instanceof Blob)) options.headers["Content-Type"] = "application/json";
    }
    let response;
    try {
      response = await fetch(address, options);
    } catch (error) {
      throw gridpose.refusal("", "The service cannot be reached. Check the network, then try again.", { status: 0 });
    }
    const isJson = (response.headers.get("content-type") || "").includes("json");
    const text = await response.text();
    if (!response.ok) {
      if (response.status === 401) gridpose.notice("You are signed out: the key expired or was revoked. ", "Sign in", "/ui/sign-in?next=" + encodeURIComponent(location.pathname + location.search));
      const number = response.headers.get("x-request-id");
      throw gridpose.refusal(text, "The service failed (" + response.status + "). " + (number ? "Its log says why, at request " + number + "." : "Try again shortly."), { status: response.status, retry: Number(response.headers.get("retry-after")) || 0 });
    }
    return { status: response.status, document: isJson && text ? JSON.parse(text) : null };
  };

  gridpose.notice = function (text, link, address) {
    const notice = document.getElementById("notice");
    notice.textContent = text || "";
    if (link) {
      const anchor = document.createElement("a");
      anchor.href = address;
      anchor.textContent = link;
      notice.append(" ", anchor);
    }
    notice.hidden = !text;
  };

  // Numbers as people type them: a comma is a point.
  function typed(field) {
    const text = field.value.trim();
    const type = field.dataset.type;
    if (type === "json") return JSON.parse(field.value);
    if (type === "boolean") return field.checked;
    if (!text) return field.hasAttribute("data-null") ? null : field.required && !type ? "" : undefined;
    if (type === "moment") return new Date(text).toISOString(); // without a zone: the reader's
    if (type === "number" || type === "integer") {
      const value = Number(text.replace(",", "."));
      return Number.isFinite(value) ? value : text; // which the service refuses, with all else that is wrong
    }
    if (type === "joints") {
      return text.split(/\r?\n/).filter((line) => line.trim()).map((line, at) => {
        const numbers = line.split(/[;\s]+|,\s*/).filter(Boolean).map(Number);
        if (numbers.length < 3 || numbers.length > 4 || numbers.some((one) => !Number.isFinite(one))) throw gridpose.refusal("", "Line " + (at + 1) + " is not: a, α, d, θ offset. Use points as decimal signs and commas between numbers.", { field: field.name });
        return { a_mm: numbers[0], alpha_deg: numbers[1], d_mm: numbers[2], theta_offset_deg: numbers[3] || 0 };
      });
    }
    if (type === "signatories") {
      return text.split(/\r?\n/).filter((line) => line.trim()).map((line) => {
        const [name, ...role] = line.split(",").map((one) => one.trim());
        return { name, role: role.join(", ") || null };
      });
    }
    return text;
  }

  gridpose.body = function (form) {
    const found = {};
    for (const field of form.elements) {
      if (!field.name || field.disabled || "skip" in field.dataset || field.closest("[hidden]")) continue;
      if (field.dataset.type === "list") {
        found[field.name] = found[field.name] || [];
        if (field.checked) found[field.name].push(field.value);
        continue;
      }
      const value = typed(field);
      if (value === undefined) continue;
      const names = field.name.split(".");
      let place = found;
      for (const name of names.slice(0, -1)) place = place[name] = place[name] || {};
      place[names[names.length - 1]] = value;
    }
    // What is stated as a whole, and is all emptied, is stated no longer.
    for (const { dataset } of form.querySelectorAll("fieldset[data-null]")) if (!(dataset.null in found)) found[dataset.null] = null;
    return found;
  };

  // A refusal on top of its form, and what is wrong with a field after that field; what was typed stays.
  gridpose.show = function (form, { box }) {
    gridpose.clear(form);
    for (const item of box.querySelectorAll("li[data-field]")) place(form, item);
    for (const list of box.querySelectorAll("ul")) if (!list.children.length) list.remove();
    if (box.textContent.trim()) form.prepend(box);
    box.tabIndex = -1;
    (form.querySelector("[aria-invalid]") || box).focus();
  };
  gridpose.clear = function (form) {
    for (const one of form.querySelectorAll(":scope > .refusal, .field-problem")) one.remove();
    for (const field of form.querySelectorAll("[aria-invalid]")) {
      field.removeAttribute("aria-invalid");
      field.setAttribute("aria-describedby", (field.getAttribute("aria-describedby") || "").split(" ").filter((id) => document.getElementById(id)).join(" "));
    }
  };
  let placed = 0;
  function place(form, item) {
    const name = item.dataset.field;
    let fields = [...form.elements].filter((one) => one.name && !one.closest("[hidden]") && one.type !== "hidden" && (one.name === name || name.startsWith(one.name + ".")));
    if (!fields.length) return;
    const isWhole = name === fields[0].name, legend = fields[0].type === "checkbox" && fields[0].closest("fieldset") && fields[0].closest("fieldset").querySelector("legend");
    if (legend && !isWhole) fields = [fields.filter((one) => one.checked)[Number(name.slice(fields[0].name.length + 1))]];
    const label = legend && isWhole ? legend : fields[0].labels[0];
    const note = Object.assign(document.createElement("p"), { className: "field-problem", id: "field-problem-" + ++placed });
    note.append(...item.childNodes);
    if (legend || isWhole) note.querySelector("b").textContent = label.textContent.trim();
    item.remove();
    let last = legend || label.contains(fields[0]) ? label : fields[0];
    while (last.nextElementSibling && last.nextElementSibling.matches(".field-problem")) last = last.nextElementSibling;
    last.after(note);
    for (const field of fields) {
      field.setAttribute("aria-invalid", "true");
      field.setAttribute("aria-describedby", ((field.getAttribute("aria-describedby") || "") + " " + note.id).trim());
    }
  }

  document.addEventListener("submit", async function (event) {
    const form = event.target;
    if (!form.dataset || !form.dataset.action) return;
    event.preventDefault();
    if (form.dataset.confirm && !window.confirm(form.dataset.confirm)) return;
    const button = form.querySelector("button"), accept = form.querySelector("[data-accept]");
    gridpose.clear(form);
    if (button) button.disabled = true;
    try {
      const method = form.dataset.method;
      const body = method === "DELETE" || form.dataset.action.endsWith("/retry") ? undefined : gridpose.body(form);
      const isRight = accept && accept.querySelector("input").checked;
      const answer = await gridpose.send(method, form.dataset.action + (isRight ? "?accept_implausible=true" : ""), body);
      const after = form.dataset.after;
      if (after === "reload") location.reload();
      else if (after === "show-key") {
        document.getElementById("secret").textContent = answer.document.key;
        document.getElementById("new-key").hidden = false;
        htmx.ajax("GET", location.href, { target: "#keys", select: "#keys", swap: "outerHTML" });
        form.reset();
      } else location.assign(after.replace("{id}", encodeURIComponent(answer.document.id)));
    } catch (error) {
      if (accept) accept.hidden = error.code !== "implausible_unit";
      gridpose.show(form, error);
    } finally {
      if (button) button.disabled = false;
    }
  });

  document.addEventListener("click", async function (event) {
    const button = event.target.closest("[data-copy]");
    if (button) {
      const text = document.getElementById(button.dataset.copy).textContent;
      try {
        await navigator.clipboard.writeText(text);
        button.textContent = "Copied";
      } catch (error) {
        // Without TLS browsers give no clipboard: select the text instead.
        getSelection().selectAllChildren(document.getElementById(button.dataset.copy));
        button.textContent = "Press Ctrl + C";
      }
    }
    const table = event.target.closest("[data-csv]");
    if (table) {
      event.preventDefault();
      const answer = await fetch(table.href, { headers: { Accept: "text/csv" }, credentials: "same-origin" });
      const link = document.createElement("a");
      link.href = URL.createObjectURL(await answer.blob());
      link.download = table.dataset.csv;
      link.click();
      URL.revokeObjectURL(link.href);
    }
    if (event.target.closest("[data-close]")) event.target.closest("dialog").close();
  });

  // Times in the reader's own zone; UTC stays as the title.
  gridpose.localise = function (root) {
    const format = new Intl.DateTimeFormat(undefined, { dateStyle: "medium", timeStyle: "short" });
    for (const time of root.querySelectorAll("time[datetime]:not([title])")) {
      const moment = new Date(time.dateTime);
      if (Number.isNaN(moment.getTime())) continue;
      time.title = time.textContent;
      time.textContent = format.format(moment);
    }
    for (const one of root.querySelectorAll("[data-copy][hidden], [data-csv][hidden], .corrections[hidden]")) one.hidden = false;
  };

  // A plot that is wider than its box can be moved by keys.
  function reachPlots() {
    for (const one of document.querySelectorAll(".paper")) {
      if (one.scrollWidth > one.clientWidth) one.tabIndex = 0;
      else one.removeAttribute("tabindex");
    }
  }

  // A table that is wider than its box says so; it loses the fade at its end.
  const boxes = new ResizeObserver((entries) => entries.forEach((one) => cue(one.target)));
  function cue(box) {
    box.classList.toggle("wide", box.scrollWidth > box.clientWidth + 1);
    box.classList.toggle("more", box.scrollWidth > box.clientWidth + box.scrollLeft + 4);
  }
  function cueTables() {
    for (const one of document.querySelectorAll(".scroll")) boxes.observe(one);
  }
  document.addEventListener("scroll", (event) => event.target.matches && event.target.matches(".scroll") && cue(event.target), true);

  // Headlines that are not computed yet, one after the other: an analysis is work for the server.
  let filling = false;
  async function fillHeadlines() {
    if (filling) return;
    filling = true;
    try {
      for (let place; (place = document.querySelector("[data-headline]")); ) {
        const address = place.dataset.headline;
        place.removeAttribute("data-headline");
        place.setAttribute("aria-busy", "true");
        const answer = await fetch(address, { headers: { "HX-Request": "true" }, credentials: "same-origin" });
        place.removeAttribute("aria-busy");
        if (answer.status === 503) break;
        if (answer.ok && place.isConnected) place.innerHTML = await answer.text();
      }
    } catch (error) {
      // The service went away; the link in the place still leads to the figures.
    } finally {
      filling = false;
    }
  }

  function setUpTheme() {
    const button = document.getElementById("theme");
    const root = document.documentElement;
    const isDark = () => root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    button.hidden = false;
    button.addEventListener("click", function () {
      root.dataset.theme = isDark() ? "light" : "dark";
      try {
        localStorage.setItem("gridpose-theme", root.dataset.theme);
      } catch (error) {
        // Storage is off: the choice holds for this page.
      }
      document.dispatchEvent(new Event("gridpose:theme"));
    });
  }

  document.addEventListener("htmx:afterSwap", function (event) {
    gridpose.localise(document);
    fillHeadlines();
    reachPlots();
    cueTables();
  });
  addEventListener("resize", reachPlots);
  document.addEventListener("load", (event) => event.target.closest && event.target.closest(".paper") && reachPlots(), true);
  document.addEventListener("htmx:sendError", () => gridpose.notice("The service cannot be reached. What you see may be old."));
  document.addEventListener("htmx:responseError", function (event) {
    if (event.detail.xhr.status !== 401) gridpose.notice("The service could not answer. Try again shortly.");
  });
  document.addEventListener("DOMContentLoaded", function () {
    setUpTheme();
    gridpose.localise(document);
    fillHeadlines();
    reachPlots();
    cueTables();
    for (const box of document.querySelectorAll("form + .refusal[data-code]")) gridpose.show(box.previousElementSibling, { box });
    for (const form of document.querySelectorAll("#estimator-form")) for (const field of form.querySelectorAll("select")) field.addEventListener("change", () => form.requestSubmit());
  });
})();
