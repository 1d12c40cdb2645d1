// Elements of the page, and numbers in words.

export const byId = (id) => document.getElementById(id);
export const radios = (name) => [...document.querySelectorAll(`input[name="${name}"]`)];
export const fixed = (v, digits) => v.toFixed(digits).replace(/^-(?=[0.]*$)/, "");
export const percent = (v) => `${(100 * v).toFixed(v < 0.1 ? 1 : 0)} %`;
