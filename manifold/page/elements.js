// Numbers as text.

export const fixed = (v, digits) => v.toFixed(digits).replace(/^-(?=[0.]*$)/, "");
export const percent = (v) => `${(100 * v).toFixed(v < 0.1 ? 1 : 0)} %`;
