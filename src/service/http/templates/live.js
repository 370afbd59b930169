// Brings the live part up to date. What its source does not tell is taken away, never left to stand.
(() => {
  const live = document.getElementById("live");
  const { from, events, state, asked: shown } = live.dataset;
  const title = document.title;
  const away = (is) => {
    document.body.classList.toggle("away", is);
    document.title = is ? "no connection" : title;
  };
  // Not more often: a small computer answers many pages.
  const rest = (ms) => new Promise((done) => setTimeout(done, ms));
  let asked = false, again = false;
  const refresh = async () => {
    if (asked) { again = true; return; }
    asked = true;
    try {
      const answer = await fetch(from, { signal: AbortSignal.timeout(5000) });
      if (!answer.ok) throw new Error(answer.statusText);
      live.innerHTML = await answer.text();
      away(false);
    } catch {
      away(true);
    }
    await rest(250);
    asked = false;
    if (again) { again = false; refresh(); }
  };
  if (!events) {
    (async () => { for (;;) { await rest(2000); await refresh(); } })();
    return;
  }
  const told = new EventSource(events);
  told.addEventListener("standing", (event) => {
    const now = JSON.parse(event.data);
    const open = now.asked ? `${now.asked.step}/${now.asked.repeat}` : "";
    // Other things can be done now, or are asked: the page is made anew.
    if (now.state !== state || open !== shown) { location.reload(); return; }
    refresh();
  });
  told.onerror = () => away(true);
  told.onopen = () => refresh();
})();
