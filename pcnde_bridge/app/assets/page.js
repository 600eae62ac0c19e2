// Hands the controls' values on when they have rested; earlier calls are answered with nothing.
(() => {
  const rest = 300; // ms
  const page = crypto.randomUUID();
  let number = 0;
  let timer = null;
  let drop = () => {};

  const rested = (blockage, position, length, scale, uploaded, shown) => {
    clearTimeout(timer);
    drop(window.dash_clientside.no_update);
    number += 1;
    const values = { page, number, blockage, position, length, scale, uploaded, shown };
    return new Promise((resolve) => {
      drop = resolve;
      timer = setTimeout(() => resolve(values), rest);
    });
  };

  window.dash_clientside = Object.assign({}, window.dash_clientside, { pcnde: { rested } });
})();
