// Hands the controls' values on when they have rested.
(() => {
  const rest = 300; // ms
  const page = crypto.randomUUID();
  let number = 0;
  let timer = null;

  const rested = (blockage, position, length, scale, uploaded, shown) => {
    clearTimeout(timer);
    number += 1;
    const data = { page, number, blockage, position, length, scale, uploaded, shown };
    timer = setTimeout(() => window.dash_clientside.set_props("rested", { data }), rest);
  };

  window.dash_clientside = Object.assign({}, window.dash_clientside, { pcnde: { rested } });
})();
