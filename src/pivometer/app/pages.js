// Live pictures, and pictures added from files.
// Ask for the next frame when the last one is shown, so that a slow computer skips.
(() => {
  const pause = (ms) => new Promise((done) => setTimeout(done, ms));
  async function play(image) {
    let after = -1, shown = null;
    while (image.isConnected) {
      try {
        if (document.hidden) { await pause(200); continue; }
        const camera = encodeURIComponent(image.dataset.live);
        const answer = await fetch(`/live/${camera}.jpg?after=${after}`, { cache: "no-store" });
        const lost = answer.headers.has("X-Lost");
        image.classList.toggle("lost", lost);
        if (answer.status !== 200) { await pause(lost ? 500 : 20); continue; }
        after = answer.headers.get("X-Frame");
        const next = URL.createObjectURL(await answer.blob());
        image.src = next;
        await image.decode().catch(() => undefined);
        if (shown) URL.revokeObjectURL(shown);
        shown = next;
        image.dataset.frames = 1 + Number(image.dataset.frames || 0);
      } catch { await pause(500); }
    }
    if (shown) URL.revokeObjectURL(shown);
  }
  function start() {
    for (const image of document.querySelectorAll("img[data-live]:not([data-playing])")) {
      image.dataset.playing = "yes";
      play(image);
    }
  }
  setInterval(start, 100);

  // Send one file after the other, and say what became of them.
  document.addEventListener("change", async (event) => {
    const input = event.target, place = input.dataset && input.dataset.add;
    if (!place) return;
    const told = input.closest("label").querySelector("output"), refused = [];
    let taken = 0;
    for (const file of input.files) {
      told.textContent = `${file.name} …`;
      const [group, camera] = place.split("/").map(encodeURIComponent);
      const address = `/pictures/${group}/${camera}/${encodeURIComponent(file.name)}`;
      const answer = await fetch(address, { method: "PUT", body: file }).catch(() => null);
      if (answer && answer.ok) taken += 1;
      else refused.push(`${file.name}: ${answer ? await answer.text() : "not sent"}`);
    }
    told.textContent = [`${taken} added`, ...refused].join("; ");
    input.value = "";
  });
})();
