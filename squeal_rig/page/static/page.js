"use strict";
// The page: takes pictures from the socket, sends commands one by one. All that comes is text, never markup.

const page = (() => {
  const $ = (id) => document.getElementById(id);
  const zones = { q: ["quiet", "quiet"], b: ["bistable", "bistable"], s: ["squeal", "squeal"], "-": ["no contact", "none"], "?": ["not known", "none"] };
  let hello = null, state = null, frame = null, map = null, socket = null, wait = 250, dirty = true, heard = 0;
  let frames = 0, commandsOpen = 0, stopsOpen = 0;
  const held = {};

  // --- commands

  async function command(content) {
    const name = content.do.replaceAll("_", " ");
    // A browser keeps six connections to a server: commands that wait for their answer leave some to the stop.
    if (commandsOpen >= 2) { say(false, `${name}: wait, the command before has no answer yet`); return; }
    commandsOpen++;
    try {
      const told = await posted(content, 75000);  // longer than the rig takes to connect a device anew
      say(told.done, `${name}: ${told.sentence}`);
    } catch (error) {
      say(false, `${name}: the page's server does not answer${error.name === "TimeoutError" ? " within 75 s, it may still be carried out" : ""}`);
    } finally {
      commandsOpen--;
    }
  }

  async function posted(content, patience) {
    const answer = await fetch("/command", {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(content), keepalive: true,
      signal: AbortSignal.timeout(patience),
    });
    return (answer.headers.get("Content-Type") || "").startsWith("application/json")
      ? answer.json() : { done: false, sentence: await answer.text() };
  }

  // What is told of a stop stands until it has its answer: no other command's answer covers it.
  function say(good, sentence, ofStop = false) {
    if (stopsOpen && !ofStop) return;
    $("answer").textContent = sentence;
    $("answer").className = good ? "ok" : "error";
  }

  async function stop() {
    if (stopsOpen >= 3) return;
    stopsOpen++;
    say(false, "EMERGENCY STOP: sent, no answer yet", true);
    try {
      const told = await posted({ do: "emergency_stop" }, 5000);
      say(told.done, `emergency stop: ${told.sentence}`, true);
    } catch (error) {
      say(false, error.name === "TimeoutError" ? "EMERGENCY STOP: no answer within 5 s; use the one that is wired"
        : "EMERGENCY STOP NOT SENT: the page's server does not answer; use the one that is wired", true);
    } finally {
      stopsOpen--;
    }
  }

  // --- the socket

  function connect() {
    socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      wait = 250;
      link("connected", "ok");
      if (sound.running()) tell({ sound: sound.rate() });
    };
    socket.onmessage = (event) => { heard = performance.now(); take(event.data); };
    socket.onclose = lost;
  }

  function lost() {
    link("no connection: trying again", "error");
    document.body.classList.add("stale");
    if (hello && hello.live) {  // nothing of what was said last is known to be so still
      for (const id of ["rig-state", "squeal-state"]) { $(id).textContent = `${id.split("-")[0]}: not known`; $(id).className = "chip big error"; }
      for (const id of ["supervisor-state", "recorder-state", "run-state"]) { $(id).textContent = "not known: no connection"; $(id).className = "error-text"; }
      for (const id of ["node-list", "findings", "run-last"]) $(id).replaceChildren();
      for (const id of ["way-back", "run-progress", "springs-fitted"]) $(id).hidden = true;
      for (const cell of document.querySelectorAll("#squeal-rows td")) if (cell.textContent === "goes on") cell.textContent = "not known";
    }
    heard = performance.now();
    setTimeout(connect, wait);
    wait = Math.min(2 * wait, 4000);
  }

  function tell(content) { if (socket && socket.readyState === 1) socket.send(JSON.stringify(content)); }

  function link(text, kind) { $("link").textContent = text; $("link").className = "chip " + kind; }

  function take(data) {
    const size = new DataView(data).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, size)));
    let offset = 4 + size;
    const arrays = {};
    for (const [name, code, count] of head.arrays) {
      arrays[name] = code === "u1" ? new Uint8Array(data, offset, count) : new Float32Array(data, offset, count);
      offset += Math.ceil((code === "u1" ? count : 4 * count) / 4) * 4;
    }
    if (head.kind === "hello") greet(head);
    else if (head.kind === "sound") { sound.take(head, arrays.sound); return; }
    else if (head.kind === "map") { map = head; held.map = null; }
    else if (head.kind === "frame") { frame = arrays.x.length ? { ...head, ...arrays } : null; frames++; }
    else if (head.kind === "state") { state = { ...head, ...arrays, counts: head }; showState(); }
    dirty = true;
  }

  // --- what is said once

  function greet(head) {
    const first = hello === null;
    hello = head;
    const live = head.live;
    $("source").textContent = live ? "live" : `recording ${head.source}`;
    for (const part of document.querySelectorAll(".live")) part.hidden = !live;
    $("bag").hidden = live;
    document.body.classList.toggle("recording", !live);
    $("emergency-stop").hidden = !live;
    $("read-only").hidden = head.control;
    if (!live) { $("time").max = head.duration; link("recording, read-only", "ok"); seek(); }
    if (first) build(head.declared);
    for (const part of document.querySelectorAll("[data-do], #set-points button, #supervisor-reset button, #springs-fitted button")) part.disabled = !head.control;
  }

  const common = ["preload", "belt_speed", "k1", "k2", "impact_impulse", "impact_direction"];

  function build(declared) {
    const rest = document.createElement("details");
    const title = document.createElement("summary");
    title.textContent = "Friction law and more";
    rest.append(title);
    const sorted = [...declared].sort((a, b) => (common.indexOf(a.name) + 99) % 99 - (common.indexOf(b.name) + 99) % 99);
    for (const one of sorted) {
      const row = document.createElement("div");
      row.className = "setting";
      const label = document.createElement("label");
      label.htmlFor = "set-" + one.name;
      label.textContent = one.unit ? `${one.name} [${one.unit}]` : one.name;
      label.title = one.what;
      const input = document.createElement(one.options.length ? "select" : "input");
      input.id = "set-" + one.name;
      input.name = one.name;
      if (one.options.length) for (const option of one.options) input.append(new Option(option, option));
      else { input.inputMode = "decimal"; input.type = "text"; }
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = "Set";
      button.setAttribute("aria-label", `Set ${one.name}`);
      const act = () => {
        const text = input.value.trim().replace(",", ".");
        const value = one.options.length ? text : Number(text);
        if (!one.options.length && (text === "" || !Number.isFinite(value))) {
          say(false, `${one.name} = ${text || "nothing"} is not a number`);
          return;
        }
        command({ do: "set", values: { [one.name]: value } });
      };
      button.addEventListener("click", act);
      input.addEventListener("keydown", (event) => { if (event.key === "Enter") { event.preventDefault(); if (!event.repeat) act(); } });
      const note = document.createElement("small");
      note.id = "note-" + one.name;
      note.textContent = one.bounds;
      row.append(label, input, button, note);
      (common.includes(one.name) ? $("set-points") : rest).append(row);
    }
    $("set-points").append(rest);
  }

  // --- what is said again and again

  const shown = (value, digits, unit = "") => {
    if (typeof value !== "number" || !Number.isFinite(value)) return "-";
    const rounded = Number(value.toPrecision(digits));
    return (Math.abs(rounded) >= 1e6 ? rounded.toExponential() : rounded.toString()) + (unit ? " " + unit : "");
  };

  function list(parent, sentences, kinds = []) {
    parent.replaceChildren(...sentences.map((text, k) => {
      const item = document.createElement("li");
      item.textContent = text;
      if (kinds[k]) item.className = kinds[k];
      return item;
    }));
  }

  function showState() {
    const n = state.numbers, told = state.told, set = state.set;
    // Health comes from every rig of the domain: this one's nodes are those of its namespace.
    const own = (name) => (node) => node.name === (hello ? hello.namespace : "") + name;
    const rig = state.nodes.find(own("rig"));
    const stopped = told.safe && told.safe.values.stopped === "true";
    const live = hello && hello.live;
    const heardOf = (name) => state.nodes.some((node) => own(name)(node) && !node.gone);
    const gone = !heardOf("rig");
    // What was last said of a rig that is gone, or that gives no samples, is not so any more.
    const silent = live && (gone || state.silent > 1.5);
    // A page that was started a moment before the rig went has had samples of it, and no word of its health.
    const known = rig || (state.blocks && state.silent > 1.5);
    document.body.classList.toggle("stale", Boolean(silent));
    $("silence").hidden = !silent;
    $("silence").textContent = state.blocks ? `no samples for ${Math.round(state.silent)} s` : "no samples yet";
    const kind = gone || stopped || rig.level >= 2 ? "error" : rig.level === 1 ? "warn" : "ok";
    $("rig-state").textContent = !live ? `rig: ${state.rig.driver || "-"}`
      : !known ? "no rig is heard" : gone ? "rig: GONE" : stopped ? `STOPPED: ${told.safe.values.reason || "emergency stop"}`
      : rig.level === 0 ? `rig: ${rig.message}` : `rig: ${["", "warning", "error"][rig.level] || "error"}`;
    $("rig-state").className = "chip big " + (live ? kind : "ok");
    const judged = n.squealing !== undefined && (!live || (!silent && heardOf("squeal_detector")));
    $("squeal-state").textContent = !judged ? "squeal: not known"
      : n.squealing ? `SQUEAL ${shown(n.frequency, 5, "Hz")}, ${shown(n.level, 3, "dB")}` : "no squeal";
    $("squeal-state").className = "chip big " + (judged ? n.squealing ? "warn" : "ok" : "");
    const toldBy = (name) => !live || heardOf(name);
    const mu = toldBy("friction_estimator") ? state.counts.mu || {} : {};
    // Nor what it said of a point that it has no samples of any more.
    const seen = !live || state.nodes.some((node) => own("stability")(node) && !node.gone && node.level < 3) ? n : {};
    const rows = [
      ...(live ? [["the rig says", stopped ? told.safe.message : rig ? rig.message : "nothing"]] : []),
      ["zone", seen.zone || "-"],
      ["stability", typeof seen.unstable === "boolean" ? `${seen.stability}, margin ${shown(seen.margin, 3)}` : seen.stability || "-"],
      ["preload in force", shown(n.preload, 5, "N")], ["preload set", shown(set.preload, 5, "N")],
      ["belt speed in force", shown(n.belt_speed, 4, "m/s")], ["belt speed set", shown(set.belt_speed, 4, "m/s")],
      ["µ, Eq. (2.2)", shown(mu.windows, 4)], ["µ, ratio of means", shown(mu.means, 4)], ["µ, truth", shown(mu.true, 4)],
      ["k", shown(seen.pad_stiffness, 4, "N/m")], ["k_cr", shown(seen.critical_stiffness, 4, "N/m")],
      ["smallest hit", shown(seen.smallest_hit, 3, "N s") + (seen.smallest_hit > 0 ? `, direction ${shown(seen.hit_direction, 4)} rad` : "")],
      ["squeal level", shown(n.level, 4, "dB re 1 µm")],
      ["tones", !n.tones ? "-" : n.tones === "none" ? "none" : n.tones.split(" ").map((f) => shown(Number(f), 5)).join(", ") + " Hz"],
      ["tones as events so far", shown(n.events, 6)],
      ["driver", `${state.rig.driver || "-"}, ${state.rig.rate ? state.rig.rate + " Hz" : "-"}`],
    ];
    $("number-list").replaceChildren(...rows.flatMap(([name, value]) => {
      const dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.textContent = name; dd.textContent = value;
      return [dt, dd];
    }));
    if (hello) for (const one of hello.declared) {
      const note = $("note-" + one.name), input = $("set-" + one.name);
      if (!note || !(one.name in set)) continue;
      const force = { preload: n.preload, belt_speed: n.belt_speed }[one.name];
      const value = typeof set[one.name] === "number" ? shown(set[one.name], 8) : set[one.name];
      note.textContent = `set ${value}` + (force === undefined ? "" : `, in force ${shown(force, 5)}`) + (one.bounds ? `; ${one.bounds}` : "");
      // A choice is never empty: it takes the rig's once.
      if ((input.value === "" || (one.options.length && !input.dataset.filled)) && document.activeElement !== input) {
        input.value = value;
        input.dataset.filled = "yes";
      }
    }
    $("hit-note").textContent = `Impact of ${shown(set.impact_impulse, 4, "N s")}; smallest hit that starts squeal: `
      + (seen.smallest_hit === 0 ? "none is needed" : shown(seen.smallest_hit, 3, "N s"));
    const level = ["ok-text", "warn-text", "error-text", "error-text"];
    const word = ["OK", "WARN", "ERROR", "STALE"];
    list($("node-list"), state.nodes.map((node) => `${word[node.level] || "?"} ${node.name}: ${node.message}`), state.nodes.map((node) => level[node.level]));
    const recorder = state.nodes.find(own("recorder"));
    const recording = recorder && !recorder.gone && recorder.values.state;
    $("recorder-state").textContent = !recorder ? "no recorder is heard" : [...new Set([recording, recorder.message])].filter(Boolean).join("; ")
      + (recording ? `, ${shown(Number(recorder.values.bytes) / 1e6, 4, "MB")}` : "");
    $("recorder-state").className = recorder ? level[recorder.level] : "";
    const superv = told.supervisor, lost = superv && !heardOf("supervisor");
    $("supervisor-state").textContent = !superv ? "no supervisor is heard" : lost ? "supervisor: GONE, nobody watches the limits"
      : `${superv.values.level || ""}: ${superv.message}`;
    $("supervisor-state").className = !superv ? "" : lost ? "error-text" : level[superv.level] || "";
    $("way-back").hidden = !(stopped || (superv && superv.level >= 2));
    $("limits").hidden = !state.limits.length;
    table("limit-rows", state.limits.map((one) => [`${one.what} [${one.unit}]`, ...[one.warn, one.ramp_down, one.stop].map((v) => shown(v, 6))]));
    list($("findings"), superv ? Object.entries(superv.values).filter(([k]) => k.startsWith("finding")).map(([k, v]) => `${k.slice(8)}: ${v}`) : []);
    const clock = (t) => new Date(1000 * t).toISOString().slice(11, 21);
    list($("trips"), [...state.trips].reverse().map((one) => `${clock(one.time)} UTC, ${one.level}: ${one.sentence}`));
    showRun(state.run, live);
    if (!live) {
      $("time-shown").textContent = `${state.time.toFixed(2)} s of ${hello.duration.toFixed(2)} s`;
      say(!state.trouble, state.trouble);
    }
    table("squeal-rows", [...state.squeals].reverse().map((one) => [
      clock(one.begin), one.end !== null ? clock(one.end) : judged ? "goes on" : "not known", shown(one.frequency, 5), shown(one.level, 3),
      shown(one.preload, 4), shown(one.belt_speed, 3),
    ]));
    $("sound-state").textContent = sound.state();
  }

  function table(id, rows) {
    $(id).replaceChildren(...rows.map((texts) => {
      const row = document.createElement("tr");
      row.append(...texts.map((text) => {
        const cell = document.createElement("td");
        cell.textContent = text;
        return cell;
      }));
      return row;
    }));
  }

  function showRun(run, live) {
    $("run-progress").hidden = !(run && run.of && !run.ended);
    $("springs-fitted").hidden = !live || !run || (run.kind === "run" && !run.of) || run.gone || Boolean(run.ended);
    $("run-state").className = "";
    $("run-last").textContent = run && run.last ? `last: ${run.last}` : "";
    if (!run) { $("run-state").textContent = "none runs"; return; }
    const one = run.kind === "campaign" ? "point" : "step";
    const counted = run.of ? `, ${run.done} of ${run.of} ${one}s done` : "";
    const failed = run.failed ? `, ${run.failed} failed` : "";
    const at = run.ended ? `; ended: ${run.ended}` : live && run.gone ? "; it is gone and did not say how it ended"
      : run.step ? `; ${one} ${run.step}: ${run.doing}` : "";
    const left = !run.ended && !run.gone && run.kind === "campaign" && Number.isFinite(run.left) ? `; about ${time(run.left)} left` : "";
    $("run-state").textContent = `${run.kind} ${run.title}${counted}${failed}${at}${left}`;
    if (run.of) { $("run-progress").max = run.of; $("run-progress").value = run.done; }
  }

  const time = (s) => s < 90 ? `${Math.round(s)} s` : s < 5400 ? `${Math.round(s / 60)} min` : `${(s / 3600).toFixed(1)} h`;

  // --- plots

  function drawMap() {
    const x = { low: 0, high: 500, title: "preload F [N]" }, y = { low: 0, high: 5, title: "belt speed V [m/s]" };
    if (map && map.preloads) { [x.low, x.high] = map.preloads; [y.low, y.high] = map.speeds; }
    const view = plots.begin($("map"), x, y);
    const { pen, box, px, py } = view;
    if (map && map.rows) {
      const rows = map.rows, columns = rows[0].length;
      const w = (box.right - box.left) / columns, h = (box.bottom - box.top) / rows.length;
      for (let r = 0; r < rows.length; r++) {
        for (let c = 0; c < columns;) {
          let end = c;
          while (end < columns && rows[r][end] === rows[r][c]) end++;
          pen.fillStyle = plots.look((zones[rows[r][c]] || zones["-"])[1]);
          pen.fillRect(box.left + c * w, box.bottom - (r + 1) * h, (end - c) * w + 0.5, h + 0.5);
          c = end;
        }
      }
      pen.textAlign = "center"; pen.textBaseline = "middle"; pen.font = "bold 13px system-ui, 'DejaVu Sans', sans-serif";
      for (const key of "qbs?") {  // named in the picture: colours alone are not for everybody
        let count = 0, sx = 0, sy = 0;
        rows.forEach((row, r) => { for (let c = 0; c < columns; c++) if (row[c] === key) { count++; sx += c; sy += r; } });
        if (count < 0.01 * rows.length * columns) continue;
        const cx = box.left + (sx / count + 0.5) * w, cy = box.bottom - (sy / count + 0.5) * h;
        const text = zones[key][0], width = pen.measureText(text).width;
        pen.fillStyle = plots.look("panel");
        pen.fillRect(cx - width / 2 - 4, cy - 9, width + 8, 18);
        pen.fillStyle = plots.look("ink");
        pen.fillText(text, cx, cy);
      }
      pen.font = "12px system-ui, 'DejaVu Sans', sans-serif";
    }
    const f = frame ? frame.preload : NaN, v = frame ? frame.belt_speed : NaN;
    const inside = Number.isFinite(f) && Number.isFinite(v) && f >= x.low && f <= x.high && v >= y.low && v <= y.high;
    if (inside) {
      pen.save();
      pen.beginPath(); pen.rect(box.left, box.top, box.right - box.left, box.bottom - box.top); pen.clip();
      const cx = px(f), cy = py(v);
      for (const [colour, size] of [["panel", 8], ["mark", 5]]) {
        pen.fillStyle = plots.look(colour);
        pen.beginPath(); pen.arc(cx, cy, size, 0, 7); pen.fill();
      }
      pen.strokeStyle = plots.look("mark"); pen.lineWidth = 2;
      pen.beginPath(); pen.arc(cx, cy, 11, 0, 7); pen.stroke();
      pen.restore();
    }
    view.axes();
    $("map-legend").textContent = !map ? (hello && !hello.live ? "Zones are computed for a live rig." : "") : map.rows ? (inside ? "The ring is where the rig stands." : Number.isFinite(f) ? "The rig stands outside the map." : "") : `Map: ${map.state}`;
  }

  function draw() {
    requestAnimationFrame(draw);
    if (!dirty || document.hidden) return;
    dirty = false;
    drawMap();
    if (frame) {
      const { x, y, rate } = frame;
      held.scope = plots.range(held.scope, [x, y], 0.15, 0.01);
      let view = plots.begin($("scope"), { low: 0, high: 1000 * x.length / rate, title: "t [ms]" }, { ...held.scope, title: "displacement [µm]" });
      plots.line(view, (k) => 1000 * k / rate, x, "one");
      plots.line(view, (k) => 1000 * k / rate, y, "two", [5, 3]);
      view.axes();
      plots.legend(view, [["x", "one", []], ["y", "two", [5, 3]]]);
      held.ox = plots.range(held.ox, [x], 0.1, 0.01);
      held.oy = plots.range(held.oy, [y], 0.1, 0.01);
      view = plots.begin($("orbit"), { ...held.ox, title: "x [µm]" }, { ...held.oy, title: "y [µm]" });
      plots.line(view, (k) => x[k], y, "one", [], 1);
      view.axes();
      view = plots.begin($("spectrum"), { low: 0, high: hello.high / 1000, title: "f [kHz]" }, { low: -100, high: 40, title: "level [dB re 1 µm]" });
      const at = frame.spectrum_at || [];
      plots.line(view, (k) => at[k] / 1000, frame.spectrum || [], "one", [], 1);
      view.axes();
    } else if (hello && !hello.live) {  // a time of a bag without samples
      for (const name of ["scope", "orbit", "spectrum"]) plots.begin($(name), { low: 0, high: 1, title: "" }, { low: 0, high: 1, title: "no samples here" }).axes();
    }
    if (state) {
      const trend = { low: -hello.trend, high: 0, title: "t [s], 0 is now" };
      let view = plots.begin($("spectrogram"), trend, { low: 0, high: hello.high / 1000, title: "f [kHz]" });
      picture(view, state.spectrogram, state.counts.columns);
      view.axes();
      const [a, b, c] = [state.mu || [], state.mu_means || [], state.mu_true || []];
      held.mu = plots.range(held.mu, [b, c], 0.3, 0.02);
      view = plots.begin($("mu"), trend, { ...held.mu, title: "µ" });
      const mt = (k) => state.mu_t[k];
      plots.line(view, mt, a, "two", [2, 3]);
      plots.line(view, mt, c, "three", [8, 4], 3);
      plots.line(view, mt, b, "one");
      view.axes();
      plots.legend(view, [["Eq. (2.2)", "two", [2, 3]], ["ratio of means", "one", []], ["truth", "three", [8, 4]]]);
      view = plots.begin($("level"), trend, { low: -100, high: 40, title: "level [dB re 1 µm]" });
      plots.line(view, (k) => state.level_t[k], state.level || [], "one");
      view.axes();
    }
  }

  const buffer = document.createElement("canvas");
  function picture(view, bytes, columns) {
    if (!columns) return;
    const lines = bytes.length / columns, most = Math.max(4 * hello.trend, columns);
    buffer.width = columns; buffer.height = lines;
    const pen = buffer.getContext("2d"), image = pen.createImageData(columns, lines);
    const out = new Uint32Array(image.data.buffer);
    for (let c = 0; c < columns; c++) for (let l = 0; l < lines; l++) out[(lines - 1 - l) * columns + c] = plots.colours[bytes[c * lines + l]];
    pen.putImageData(image, 0, 0);
    const { box } = view, width = (box.right - box.left) * columns / most;
    view.pen.imageSmoothingEnabled = false;
    view.pen.drawImage(buffer, box.right - width, box.top, width, box.bottom - box.top);
  }

  // --- bags

  function seek() {
    const t = Number($("time").value);
    $("time-shown").textContent = `${t.toFixed(2)} s is being read`;
    tell({ seek: t });
  }

  // --- everything that can be pressed

  function wire() {
    $("emergency-stop").addEventListener("click", stop);
    document.addEventListener("keydown", (event) => {
      if (event.key === "Escape" && !event.repeat && !(hello && !hello.live)) { event.preventDefault(); stop(); }
    }, true);
    for (const button of document.querySelectorAll("[data-do]")) button.addEventListener("click", () => command({ do: button.dataset.do }));
    $("set-points").addEventListener("submit", (event) => event.preventDefault());
    $("supervisor-reset").addEventListener("submit", (event) => {
      event.preventDefault();
      command({ do: "supervisor_reset", reason: event.target.reason.value });
    });
    $("springs-fitted").addEventListener("submit", (event) => {
      event.preventDefault();
      command({ do: "springs_fitted", name: event.target.name.value });
    });
    $("sound").addEventListener("click", () => {
      const on = !sound.running();
      if (on) tell({ sound: sound.start(Number($("volume").value)) });
      else { sound.stop(); tell({ sound: 0 }); }
      $("sound").setAttribute("aria-pressed", String(on));
      $("sound").textContent = on ? "Listening" : "Listen";
    });
    $("volume").addEventListener("input", () => sound.volume(Number($("volume").value)));
    let due = 0;
    $("time").addEventListener("input", () => { clearTimeout(due); due = setTimeout(seek, 80); });
    for (const plot of document.querySelectorAll(".plot")) {
      const name = plot.querySelector("h2").textContent, canvas = plot.querySelector("canvas");
      const button = document.createElement("button");
      button.type = "button"; button.className = "save"; button.textContent = "Save";
      button.setAttribute("aria-label", `Save the picture ${name}`);
      button.addEventListener("click", () => canvas.toBlob((blob) => {
        const way = document.createElement("a");
        way.href = URL.createObjectURL(blob);
        way.download = `squeal_rig_${canvas.id}_${new Date().toISOString().replace(/[:.]/g, "-")}.png`;
        way.click();
        setTimeout(() => URL.revokeObjectURL(way.href), 10000);
      }));
      plot.append(button);
    }
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { dirty = true; });
    addEventListener("resize", () => { dirty = true; });
    setInterval(() => {  // a connection that says nothing is none, and its end may take a minute to be noticed
      if (socket.readyState !== 1 || !hello || !hello.live || performance.now() - heard <= 5000) return;
      const old = socket;
      old.onclose = old.onmessage = old.onopen = null;
      old.close();
      lost();
    }, 1000);
  }

  wire();
  connect();
  requestAnimationFrame(draw);
  return { frames: () => frames, state: () => state, frame: () => frame, map: () => map };
})();
