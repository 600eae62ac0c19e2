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

  window.dash_clientside = Object.assign({}, window.dash_clientside, { pcnde: { settled } });
})();
