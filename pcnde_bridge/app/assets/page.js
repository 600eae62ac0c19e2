// Passes on the values of the controls when they have settled.
(() => {
  const delay = 300; // ms
  const page = crypto.randomUUID();
  let number = 0;
  let timer = null;

  const settled = (blockage, position, length, scale, uploaded, shown) => {
    clearTimeout(timer);
    number += 1;
    const data = { page, number, blockage, position, length, scale, uploaded, shown };
    timer = setTimeout(() => window.dash_clientside.set_props("settled", { data }), delay);
  };

  // Dash moves a number that was typed into the control's range, but does not report it.
  document.addEventListener("change", (event) => {
    const box = event.target;
    if (!box.closest(".dash-slider-container") || box.value === "") return;
    const value = Math.min(Math.max(Number(box.value), Number(box.min)), Number(box.max));
    // As if it had been typed: React watches the value that is set on the element itself.
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(box, value);
    box.dispatchEvent(new Event("input", { bubbles: true }));
  });

  // Sliders and their number boxes have the name of their label, or of their column.
  const name = () => {
    for (const slider of document.querySelectorAll(".dash-slider-container")) {
      const place = slider.closest(".control, .place");
      const label = place && place.querySelector("label, h3");
      for (const part of slider.querySelectorAll("[role=slider], input")) {
        if (label && part.getAttribute("aria-label") !== label.textContent)
          part.setAttribute("aria-label", label.textContent);
      }
    }
  };
  new MutationObserver(name).observe(document, { childList: true, subtree: true });

  window.dash_clientside = Object.assign({}, window.dash_clientside, { pcnde: { settled } });
})();
