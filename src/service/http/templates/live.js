// Brings the live part up to date. What its source does not tell is taken away, never left to stand.
(() => {
  const live = document.getElementById("live");
  const { from, events, state, asked: shown } = live.dataset;
  const name = document.title;
  const machine = document.querySelector("h1").textContent;
  // Signs of life come every 5 s; the slow parts are asked for every minute.
  const SILENT = 10000, SLOW = 60000, STALE = 150000, BESIDE = 2000;
  const away = (is) => {
    document.body.classList.toggle("away", is);
    const glance = events ? live.querySelector(".glance") : null;
    const title = glance ? `${machine}: ${glance.firstChild.textContent.trim()}` : name;
    document.title = is ? "no connection" : title;
  };
  // By the clock on the wall, which goes on while a tablet sleeps; one that is set looks like silence, which
  // the next sign of life mends.
  const over = (at, ms) => Math.abs(Date.now() - at) > ms;
  const text = async (what) => {
    const answer = await fetch(what, { signal: AbortSignal.timeout(5000) });
    if (!answer.ok) throw new Error(answer.statusText);
    return answer.text();
  };
  // Not more often: a small computer answers many pages.
  const rest = (ms) => new Promise((done) => setTimeout(done, ms));
  const refresher = (part, from) => {
    let asked = false, again = false;
    const refresh = async () => {
      if (asked) { again = true; return; }
      asked = true;
      try {
        part.innerHTML = await text(from);
        away(false);
      } catch {
        away(true);
      }
      await rest(250);
      asked = false;
      if (again) { again = false; refresh(); }
    };
    return refresh;
  };
  const refresh = refresher(live, from);
  if (!events) {
    (async () => { for (;;) { await rest(2000); await refresh(); } })();
    return;
  }

  // Schedule, trends and runs, from the page as it would be made now. What is open stays open.
  const slow = document.querySelectorAll(".slow");
  const within = (part, what) => [...part.querySelectorAll(what)];
  const replace = (part, fresh) => {
    const open = within(part, "details").map((one) => one.open);
    const focused = within(part, "a, summary, [tabindex]").indexOf(document.activeElement);
    part.innerHTML = fresh.innerHTML;
    within(part, "details").forEach((one, index) => { one.open = open[index] === true; });
    within(part, "a, summary, [tabindex]")[focused]?.focus({ preventScroll: true });
  };
  let made = Date.now(), tried = Date.now();
  const refreshSlow = async () => {
    tried = Date.now();
    try {
      const page = new DOMParser().parseFromString(await text(location.pathname), "text/html");
      const fresh = within(page, ".slow");
      // A schedule that is known only now has its own forms beside it.
      if (fresh.length !== slow.length) { location.reload(); return; }
      slow.forEach((part, index) => replace(part, fresh[index]));
      made = Date.now();
    } catch { /* they go when they are too old */ }
  };

  // While a person is asked the values of sensors change all the time, and the rest rarely.
  const sensors = document.getElementById("sensors");
  const refreshSensors = sensors && refresher(sensors, sensors.dataset.from);
  let refreshed = Date.now();
  let told, heard;
  const listen = () => {
    told?.close();
    heard = Date.now();
    told = new EventSource(events);
    told.addEventListener("standing", (event) => {
      heard = Date.now();
      const now = JSON.parse(event.data);
      const watched = now.asked?.live ? "/sensors" : "";
      const open = now.asked ? `${now.asked.step}/${now.asked.repeat}${watched}` : "";
      // Other things can be done now, or are asked: the page is made anew.
      if (now.state !== state || open !== shown) { location.reload(); return; }
      if (sensors) {
        refreshSensors();
        if (!over(refreshed, BESIDE)) return;
        refreshed = Date.now();
      }
      refresh();
    });
    told.onerror = () => away(true);
  };
  listen();
  setInterval(() => {
    // A connection that is silent may never say that it is dead: another is tried.
    if (over(heard, SILENT)) { away(true); listen(); }
    if (over(tried, SLOW)) refreshSlow();
    document.body.classList.toggle("stale", over(made, STALE));
  }, 1000);
})();
