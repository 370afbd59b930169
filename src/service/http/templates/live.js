// Updates the live part. A value that the server no longer reports is removed, never left on the page. The page
// stays open while the service is restarted: the browser's own error page would not return to the machine.
(() => {
  document.body.classList.add("updated");
  const live = document.getElementById("live");
  const { from, events, state, asked: shownPrompt } = live.dataset;
  const name = document.title;
  const machine = document.querySelector("h1").textContent;
  // The server sends an event at least every 5 s; the slow parts are requested every minute.
  const MAX_EVENT_GAP_MS = 10000, SLOW_PERIOD_MS = 60000, MAX_SLOW_AGE_MS = 150000, PROMPT_REFRESH_MS = 2000;
  const showConnectionLost = (is) => {
    document.body.classList.toggle("away", is);
    const glance = events ? live.querySelector(".glance") : null;
    const title = glance ? `${machine}: ${glance.firstChild.textContent.trim()}` : name;
    document.title = is ? "no connection" : title;
  };
  // Uses the system time, which continues while a tablet sleeps. A clock that is set looks like a lost connection
  // until the next event.
  const isOlder = (at, ms) => Math.abs(Date.now() - at) > ms;
  const fetchText = async (what) => {
    const response = await fetch(what, { signal: AbortSignal.timeout(5000) });
    // The session has expired or was lost in a restart; the reload leads to the sign-in page.
    if (response.status === 401) location.reload();
    if (!response.ok) throw new Error(response.statusText);
    return response.text();
  };
  // Reloads the page after the service has answered.
  const reloadWhenAnswered = async () => {
    try {
      await fetchText(location.href);
      location.reload();
    } catch {
      showConnectionLost(true);
    }
  };
  // Limits the request rate: a small computer serves many pages.
  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  const refresher = (part, from) => {
    let asked = false, again = false;
    const refresh = async () => {
      if (asked) { again = true; return; }
      asked = true;
      try {
        part.innerHTML = await fetchText(from);
        showConnectionLost(false);
      } catch {
        showConnectionLost(true);
      }
      await wait(250);
      asked = false;
      if (again) { again = false; refresh(); }
    };
    return refresh;
  };
  const refresh = refresher(live, from);
  if (!events) {
    (async () => { for (;;) { await wait(2000); await refresh(); } })();
    return;
  }

  // A hold is sent without leaving the page, so that the page can report that it was not confirmed. The response is a
  // redirection to this page; it is not followed, because it already confirms the hold.
  document.addEventListener("submit", async (event) => {
    const form = event.target;
    if (!form.action.endsWith("/hold")) return;
    event.preventDefault();
    try {
      const body = new URLSearchParams(new FormData(form));
      const request = { method: "POST", body, redirect: "manual", signal: AbortSignal.timeout(3000) };
      const response = await fetch(form.action, request);
      if (response.ok || response.type === "opaqueredirect") reloadWhenAnswered(); else form.submit();
    } catch {
      const alert = form.querySelector("[role=alert]") ?? form.appendChild(document.createElement("p"));
      alert.setAttribute("role", "alert");
      alert.textContent = "The hold is not confirmed: no response. Stop the machine at its control.";
    }
  });

  // Schedule, trends and runs, from a newly requested page. Open details stay open.
  const slow = document.querySelectorAll(".slow");
  const within = (part, what) => [...part.querySelectorAll(what)];
  const replace = (part, fresh) => {
    const open = within(part, "details").map((one) => one.open);
    const focused = within(part, "a, summary, [tabindex]").indexOf(document.activeElement);
    part.innerHTML = fresh.innerHTML;
    within(part, "details").forEach((one, index) => { one.open = open[index] === true; });
    within(part, "a, summary, [tabindex]")[focused]?.focus({ preventScroll: true });
  };
  let refreshedSlow = Date.now(), requestedSlow = Date.now();
  const refreshSlow = async () => {
    requestedSlow = Date.now();
    try {
      const page = new DOMParser().parseFromString(await fetchText(location.pathname), "text/html");
      const fresh = within(page, ".slow");
      // A schedule that is new has its own forms, which only a reload shows.
      if (fresh.length !== slow.length) { location.reload(); return; }
      slow.forEach((part, index) => replace(part, fresh[index]));
      refreshedSlow = Date.now();
    } catch { /* the slow parts are hidden when they are too old */ }
  };

  // While a prompt is open, the values of the sensors change continuously, and the rest rarely.
  const sensors = document.getElementById("sensors");
  const refreshSensors = sensors && refresher(sensors, sensors.dataset.from);
  let refreshed = Date.now();
  let source, lastEvent, endAnnounced = false;
  const connect = () => {
    source?.close();
    lastEvent = Date.now();
    source = new EventSource(events);
    source.addEventListener("standing", (event) => {
      lastEvent = Date.now();
      const now = JSON.parse(event.data);
      // A reload would fail, because the service ends. The next event comes from the restarted service.
      if (now.state === "ending") { endAnnounced = true; refresh(); return; }
      const watched = now.asked?.live ? "/sensors" : "";
      const open = now.asked ? `${now.asked.step}/${now.asked.repeat}${watched}` : "";
      // Other actions are possible now, or another prompt is open: reload the page.
      if (endAnnounced || now.state !== state || open !== shownPrompt) { reloadWhenAnswered(); return; }
      if (sensors) {
        refreshSensors();
        if (!isOlder(refreshed, PROMPT_REFRESH_MS)) return;
        refreshed = Date.now();
      }
      refresh();
    });
    source.onerror = () => {
      showConnectionLost(true);
      // The response is not an event stream: for example a proxy error, or an expired session.
      if (source.readyState === EventSource.CLOSED) refresh();
    };
  };
  connect();
  setInterval(() => {
    // A connection without events may be dead without an error: open another one.
    if (isOlder(lastEvent, MAX_EVENT_GAP_MS)) { showConnectionLost(true); connect(); }
    if (isOlder(requestedSlow, SLOW_PERIOD_MS)) refreshSlow();
    document.body.classList.toggle("stale", isOlder(refreshedSlow, MAX_SLOW_AGE_MS));
  }, 1000);
})();
