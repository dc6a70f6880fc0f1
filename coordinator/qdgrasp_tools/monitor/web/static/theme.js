// The theme: light, dark, or as the system has it. Loaded before the page is drawn, so that nothing flashes.
(() => {
  const NAMES = { auto: "as the system has them", light: "light", dark: "dark" };
  const ORDER = Object.keys(NAMES);
  const root = document.documentElement;
  const system = matchMedia("(prefers-color-scheme: dark)");

  function stored() {
    try {
      const name = localStorage.getItem("theme");
      return ORDER.includes(name) ? name : "auto";
    } catch {
      return "auto";
    }
  }

  function store(name) {
    try {
      localStorage.setItem("theme", name);
    } catch {
      // without storage the choice lasts until the page is closed
    }
  }

  function apply(name) {
    if (name === "auto") delete root.dataset.theme;
    else root.dataset.theme = name;
    document.dispatchEvent(new Event("themechange"));
  }

  let name = stored();
  apply(name);
  system.addEventListener("change", () => apply(name));
  document.addEventListener("DOMContentLoaded", () => {
    const button = document.getElementById("theme");
    const label = () => {
      button.textContent = name[0].toUpperCase() + name.slice(1);
      button.setAttribute("aria-label", `Colours: ${NAMES[name]}`);
    };
    button.addEventListener("click", () => {
      name = ORDER[(ORDER.indexOf(name) + 1) % ORDER.length];
      store(name);
      apply(name);
      label();
    });
    label();
  });
})();
