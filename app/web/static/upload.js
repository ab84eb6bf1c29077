// Adding images: folders and files dropped or chosen, their poses shown first, hashed here, and only what is missing sent.
(function () {
  "use strict";
  const TOGETHER = 3, SHOWN = 300, ASKED = 500, TRIES = 6;
  const IMAGE = /\.(png|jpe?g|tiff?|bmp)$/i, POSE = /^[A-Za-z0-9_-][A-Za-z0-9._-]{0,127}$/;

  // Poses, cycles and images of one stop from names, as `gridpose upload` reads them.
  const BURST = "(?:burst|b)[-_]?(?<burst>[0-9]{1,4})";
  const naming = (cycle, gap) => new RegExp("^" + cycle + "(?:" + gap + BURST + ")?$", "i");
  const MARKED = naming("(?<name>.*?)(?:^|[-_. ])(?:cycle|c)[-_]?(?<cycle>[0-9]{1,10})", "[-_. ]?");
  const NUMBERED = naming("(?<name>.+)_(?<cycle>[0-9]{1,10})", "[-_. ]"), NUMBER = naming("(?<cycle>[0-9]{1,10})", "[-_. ]");
  function usualTag(folders, stem, isOneFolder) {
    const marked = stem.match(MARKED), folder = folders.at(-1), number = stem.match(NUMBER);
    const tag = (pose, { groups } = { groups: {} }) => [pose, groups.cycle ? Number(groups.cycle) : null, groups.burst ? Number(groups.burst) : null];
    if (folders.length > (isOneFolder ? 1 : 0)) return tag(folder, marked || number || undefined);
    if (folder && (number || (marked && !marked.groups.name))) return tag(folder, number || marked);
    const split = marked || stem.match(NUMBERED);
    return split && split.groups.name ? tag(split.groups.name, split) : tag(stem);
  }
  const LETTERS = { ä: "ae", ö: "oe", ü: "ue", Ä: "Ae", Ö: "Oe", Ü: "Ue", ß: "ss", ø: "oe", Ø: "Oe", æ: "ae", Æ: "Ae", å: "aa", Å: "Aa", ł: "l", Ł: "L" };
  function legalPose(text) {
    if (POSE.test(text)) return text;
    const plain = text.normalize("NFC").replace(/[äöüÄÖÜßøØæÆåÅłŁ]/g, (letter) => LETTERS[letter]).normalize("NFKD").replace(/\p{Mn}/gu, "");
    const legal = plain.replace(/[^A-Za-z0-9._-]+/g, "-").replace(/^-+|-+$/g, "").replace(/^\.+/, "");
    return POSE.test(legal) ? legal : text;
  }

  document.addEventListener("DOMContentLoaded", function () {
    const place = document.getElementById("upload");
    place.hidden = false;
    const session = place.dataset.session, limit = Number(place.dataset.maxBytes);
    const drop = document.getElementById("drop"), plan = document.getElementById("plan"), rule = document.getElementById("rule");
    const rows = document.getElementById("rows"), report = document.getElementById("report"), sent = document.getElementById("sent");
    const send = document.getElementById("send"), pause = document.getElementById("pause");
    let files = [], isSending = false, isPaused = false;
    const isCounted = () => ["folder", "one"].includes(rule.elements.pattern.value);
    const taken = new Map(Object.entries(JSON.parse(place.dataset.cycles))); // the last cycle of each pose, here or given

    // Natural order, so that image 10 comes after image 9: cycles follow it.
    const order = new Intl.Collator("en", { numeric: true });
    function assign() {
      const pattern = rule.elements.pattern.value, counted = new Map(), given = new Map();
      // The folder chosen is no pose: its sub-folders are, and so are several that were chosen.
      const isOneFolder = new Set(files.map((one) => one.path.split("/")).filter((parts) => parts.length > 1).map((parts) => parts[0])).size < 2;
      document.getElementById("one-pose").hidden = pattern !== "one";
      files.sort((a, b) => order.compare(a.path, b.path));
      for (const one of files) {
        if (one.done) continue;
        const folders = one.path.split("/"), stem = folders.pop().replace(IMAGE, "");
        let named = stem, cycle = null, burst = null;
        if (pattern === "one") named = rule.elements.pose.value.trim();
        else if (pattern === "folder") named = folders.at(-1) || stem;
        else if (pattern === "auto") [named, cycle, burst] = usualTag(folders, stem, isOneFolder);
        const pose = legalPose(named);
        if (!given.has(pose)) given.set(pose, named);
        if (isCounted()) { cycle = (counted.get(pose) ?? taken.get(pose) ?? 0) + 1; counted.set(pose, cycle); }
        Object.assign(one, { pose, cycle, burst, label: pose === named ? "" : named, isNumbered: false });
        one.state = problem(one, given.get(pose), named) || "to send";
      }
      show();
    }
    function problem({ file, pose, cycle, burst }, first, named) {
      if (!POSE.test(pose)) return "no pose: it takes letters a to z, digits, . _ and -";
      if (first !== named) return "no pose of its own: " + first + " is " + pose + ", too";
      if (cycle === 0) return "cycle 0: cycles count from 1";
      if (burst === 0) return "image 0: the images of a stop count from 1";
      return file.size > limit ? "too large" : file.size ? "" : "empty";
    }
    function show() {
      const ready = files.filter((one) => one.state === "to send"), poses = new Set(files.map((one) => one.pose));
      plan.hidden = !files.length;
      document.getElementById("plan-title").textContent = files.length + (files.length === 1 ? " image" : " images") + " at " + poses.size + (poses.size === 1 ? " pose" : " poses");
      const going = [...poses].filter((pose) => taken.has(pose) && ready.some((one) => one.pose === pose && !one.isNumbered));
      document.getElementById("goes-on").textContent = isCounted() && going.length ? "The session has cycles of " + going.slice(0, 5).join(", ") + (going.length > 5 ? " and " + (going.length - 5) + " more poses" : "") + ": the count goes on after them. Images that are here already keep their cycle." : "";
      document.getElementById("camera-only").hidden = poses.size < files.length;
      // What needs a look first, then the rest in order.
      const isOdd = (one) => one.why || !["to send", "sent", "was here"].includes(one.state);
      const shown = [...files.filter(isOdd), ...files.filter((one) => !isOdd(one))].slice(0, SHOWN);
      rows.replaceChildren(...shown.map(function (one) {
        const row = document.createElement("tr");
        for (const [at, text] of [one.path, one.pose || "–", one.cycle === null ? "–" : one.cycle + (one.burst ? ", image " + one.burst : ""), (one.file.size / 1e6).toFixed(2) + " MB", one.why ? (one.state === "to send" ? "to send again" : one.state) + ": " + one.why : one.state].entries()) {
          const cell = document.createElement(at ? "td" : "th");
          if (!at) cell.scope = "row";
          const text_ = document.createElement("bdi");
          text_.textContent = text;
          cell.append(text_);
          row.append(cell);
        }
        return row;
      }));
      document.getElementById("more").textContent = files.length > SHOWN ? "and " + (files.length - SHOWN) + " more" : "";
      send.disabled = isSending || !ready.length;
      send.textContent = ready.length ? "Send " + ready.length + (ready.length === 1 ? " image" : " images") : "Send";
    }
    function add(found) {
      const known = new Set(files.map((one) => one.path + "\0" + one.file.size));
      let others = 0;
      for (const { file, path } of found) {
        if (!IMAGE.test(file.name)) { others += 1; continue; }
        if (!known.has(path + "\0" + file.size)) files.push({ file, path, state: "to send", done: false });
      }
      report.textContent = others ? others + (others === 1 ? " file is" : " files are") + " no image and will not be sent." : "";
      assign();
    }
    for (const id of ["files", "folder"]) document.getElementById(id).addEventListener("change", function (event) {
      add([...event.target.files].map((file) => ({ file, path: file.webkitRelativePath || file.name })));
      event.target.value = "";
    });
    for (const name of ["dragenter", "dragover"]) drop.addEventListener(name, (event) => { event.preventDefault(); drop.classList.add("over"); });
    for (const name of ["dragleave", "drop"]) drop.addEventListener(name, () => drop.classList.remove("over"));
    drop.addEventListener("drop", async function (event) {
      event.preventDefault();
      const entries = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry && item.webkitGetAsEntry()).filter(Boolean);
      const loose = [...event.dataTransfer.files];
      const found = [];
      for (const entry of entries) await walk(entry, found);
      add(entries.length ? found : loose.map((file) => ({ file, path: file.name })));
    });
    async function walk(entry, found) {
      if (entry.isFile) {
        const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
        found.push({ file, path: entry.fullPath.replace(/^\//, "") });
      } else {
        const reader = entry.createReader();
        for (let batch; (batch = await new Promise((resolve, reject) => reader.readEntries(resolve, reject))).length; ) for (const one of batch) await walk(one, found);
      }
    }
    for (const name of ["change", "input"]) rule.addEventListener(name, () => { if (!isSending) assign(); });
    rule.addEventListener("submit", (event) => event.preventDefault());
    document.getElementById("clear").addEventListener("click", () => { if (!isSending) { files = []; report.textContent = ""; sent.hidden = true; show(); } });
    pause.addEventListener("click", () => { isPaused = true; pause.disabled = true; });

    async function sha256(file) {
      const bytes = new Uint8Array(await file.arrayBuffer());
      if (!(window.crypto && crypto.subtle)) return plainSha256(bytes);
      return [...new Uint8Array(await crypto.subtle.digest("SHA-256", bytes))].map((one) => one.toString(16).padStart(2, "0")).join("");
    }
    const wait = (seconds) => new Promise((resolve) => setTimeout(resolve, 1000 * seconds));
    // What the network or the service refuses for the moment is tried again; sending twice stores once.
    async function insist(work) {
      for (let attempt = 1; ; attempt++) {
        try { return await work(); } catch (error) {
          if (isPaused || attempt === TRIES || !(error.status === 0 || error.status === 503)) throw error;
          await wait(error.retry || Math.min(20, 2 ** (attempt - 1)));
        }
      }
    }
    send.addEventListener("click", async function () {
      isSending = true; isPaused = false;
      pause.hidden = false; pause.disabled = false; sent.hidden = false;
      for (const field of rule.elements) field.disabled = true;
      const due = files.filter((one) => one.state === "to send");
      sent.max = due.length; sent.value = 0;
      let added = 0, here = 0, failed = 0, stopped = "";
      const tally = () => { sent.value = added + here + failed; report.textContent = added + " sent, " + here + " were here already, " + failed + " refused, " + (due.length - added - here - failed) + " to go." + (stopped ? " Stopped: " + stopped + " Send goes on from here." : ""); };
      for (const one of due) one.why = "";
      try {
        for (let start = 0; start < due.length && !isPaused; start += ASKED) {
          const batch = due.slice(start, start + ASKED);
          for (const one of batch) { if (!one.sha256) one.sha256 = await sha256(one.file); if (isPaused) break; }
          const ready = batch.filter((one) => one.sha256);
          const asked = await insist(() => gridpose.send("POST", "/v1/sessions/" + session + "/images/missing", { images: ready.map((one) => ({ pose_id: one.pose, sha256: one.sha256 })) }));
          const missing = new Set(asked.document.missing.map((one) => one.pose_id + "/" + one.sha256));
          for (const one of ready) if (!missing.has(one.pose + "/" + one.sha256)) { one.state = "was here"; one.done = true; here += 1; }
          const queue = ready.filter((one) => !one.done);
          // Counted here, where it is known which are new: an upload that was interrupted goes on as it began.
          if (isCounted()) for (const one of queue) if (!one.isNumbered) {
            one.cycle = (taken.get(one.pose) || 0) + 1;
            taken.set(one.pose, one.cycle);
            one.isNumbered = true;
          }
          tally(); show();
          await Promise.all(Array.from({ length: TOGETHER }, async function () {
            for (let one; !isPaused && (one = queue.shift()); ) {
              const query = new URLSearchParams({ filename: one.file.name, focus_group: rule.elements.focus_group.value.trim() || "default" });
              if (one.cycle !== null) query.set("cycle", one.cycle);
              if (one.burst) query.set("burst", one.burst);
              const label = one.label.replace(/\p{C}/gu, "").slice(0, 200);
              if (label) query.set("pose_label", label);
              try {
                const answer = await insist(() => gridpose.send("PUT", "/v1/sessions/" + session + "/poses/" + encodeURIComponent(one.pose) + "/images/" + one.sha256 + "?" + query, one.file, { "Content-Type": "application/octet-stream" }));
                one.done = true;
                if (answer.status === 202) { one.state = "sent"; added += 1; } else { one.state = "was here"; here += 1; }
              } catch (error) {
                one.why = error.message;
                // Not this image's fault: the next would end alike, and all can be sent when that is mended.
                if ([0, 401, 403, 503, 507].includes(error.status)) { stopped = error.message; isPaused = true; }
                else { one.state = "refused"; failed += 1; }
                show();
              }
              tally();
            }
          }));
          show();
        }
      } catch (error) {
        report.textContent = error.message;
        isPaused = true;
      }
      isSending = false;
      pause.hidden = true;
      for (const field of rule.elements) field.disabled = false;
      show();
      if (added + here) {
        const link = document.createElement("a");
        link.href = "/ui/sessions/" + session;
        link.textContent = "See the images";
        report.append(" ", link);
      }
    });
    window.addEventListener("beforeunload", (event) => { if (isSending) event.preventDefault(); });

    // SHA-256 (FIPS 180-4) for pages without TLS, where browsers offer none.
    function plainSha256(bytes) {
      const primes = [], isPrime = (n) => { for (let k = 2; k * k <= n; k++) if (n % k === 0) return false; return true; };
      for (let n = 2; primes.length < 64; n++) if (isPrime(n)) primes.push(n);
      const part = (x) => ((x - Math.floor(x)) * 4294967296) | 0;
      const K = primes.map((p) => part(Math.cbrt(p))), H = primes.slice(0, 8).map((p) => part(Math.sqrt(p)));
      const length = bytes.length, padded = new Uint8Array(((length + 72) >> 6) << 6), view = new DataView(padded.buffer);
      padded.set(bytes);
      padded[length] = 0x80;
      view.setUint32(padded.length - 8, Math.floor(length / 536870912));
      view.setUint32(padded.length - 4, (length << 3) >>> 0);
      const w = new Int32Array(64), turn = (x, n) => (x >>> n) | (x << (32 - n));
      for (let at = 0; at < padded.length; at += 64) {
        for (let t = 0; t < 16; t++) w[t] = view.getInt32(at + 4 * t);
        for (let t = 16; t < 64; t++) {
          const a = w[t - 15], b = w[t - 2];
          w[t] = (w[t - 16] + w[t - 7] + (turn(a, 7) ^ turn(a, 18) ^ (a >>> 3)) + (turn(b, 17) ^ turn(b, 19) ^ (b >>> 10))) | 0;
        }
        let [a, b, c, d, e, f, g, h] = H;
        for (let t = 0; t < 64; t++) {
          const t1 = (h + (turn(e, 6) ^ turn(e, 11) ^ turn(e, 25)) + ((e & f) ^ (~e & g)) + K[t] + w[t]) | 0;
          const t2 = ((turn(a, 2) ^ turn(a, 13) ^ turn(a, 22)) + ((a & b) ^ (a & c) ^ (b & c))) | 0;
          h = g; g = f; f = e; e = (d + t1) | 0; d = c; c = b; b = a; a = (t1 + t2) | 0;
        }
        [a, b, c, d, e, f, g, h].forEach((value, k) => { H[k] = (H[k] + value) | 0; });
      }
      return H.map((value) => (value >>> 0).toString(16).padStart(8, "0")).join("");
    }
    gridpose.plainSha256 = plainSha256;
  });
})();
