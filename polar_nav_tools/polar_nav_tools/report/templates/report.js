// The page follows the system's light or dark scheme; the button overrules it until the page is closed.
(() => {
  const button = document.getElementById('theme');
  const root = document.documentElement;
  const dark = () => matchMedia('(prefers-color-scheme: dark)').matches;
  const now = () => root.dataset.theme ?? (dark() ? 'dark' : 'light');
  const label = () => { button.textContent = now() === 'dark' ? 'Light' : 'Dark'; };
  button.hidden = false;
  button.addEventListener('click', () => { root.dataset.theme = now() === 'dark' ? 'light' : 'dark'; label(); });
  addEventListener('beforeprint', () => document.querySelectorAll('details').forEach((d) => { d.open = true; }));
  label();
})();
