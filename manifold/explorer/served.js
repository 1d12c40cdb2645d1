// What only a served page can do: commands, asked of the program that serves it. Elsewhere these controls are absent.

/** Connect the controls of actions; null where the page is a file. */
export function serve(explorer, served) {
  return served ? null : null;
}
