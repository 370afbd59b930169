// Brings the live part up to date. A value whose source does not answer is taken away, never left to stand.
(() => {
  const live = document.getElementById("live");
  const here = "/machines/" + encodeURIComponent(live.dataset.machine);
  const away = (is) => document.body.classList.toggle("away", is);
  // Not more often: a small computer answers many pages.
  const rest = () => new Promise((done) => setTimeout(done, 250));
  let asked = false, again = false;
  const refresh = async () => {
    if (asked) { again = true; return; }
    asked = true;
    try {
      const answer = await fetch(here + "/live");
      if (!answer.ok) throw new Error(answer.statusText);
      live.innerHTML = await answer.text();
      away(false);
    } catch {
      away(true);
    }
    await rest();
    asked = false;
    if (again) { again = false; refresh(); }
  };
  const events = new EventSource("/api/v1" + here + "/events");
  events.addEventListener("standing", (event) => {
    const { state } = JSON.parse(event.data);
    // Other things can be done now: the page is made anew.
    if (state !== live.dataset.state) { location.reload(); return; }
    refresh();
  });
  events.onerror = () => away(true);
  events.onopen = () => refresh();
})();
