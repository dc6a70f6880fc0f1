// Elements and tables: made once, then changed only where they differ, so that focus, text selection and
// scrolling stay.

/** Whether the system has dark colours; it changes while the page is open. */
export const darkMode = matchMedia("(prefers-color-scheme: dark)");

/** A new element; an attribute that is null or false is left out, true sets it empty. */
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) setAttribute(made, name, value);
  made.append(...children);
  return made;
}

export function setAttribute(node, name, value) {
  if (value === null || value === false) node.removeAttribute(name);
  else if (node.getAttribute(name) !== String(value)) node.setAttribute(name, value === true ? "" : value);
}

export function setText(node, words) {
  if (node.textContent !== words) node.textContent = words;
}

/** Give `parent` one child per item, in the items' order: known ones (by key) stay, others are made or removed. */
export function updateChildren(parent, items, keyOf, make, update) {
  const known = new Map([...parent.children].map((child) => [child.dataset.key, child]));
  let place = parent.firstElementChild;
  for (const item of items) {
    const key = String(keyOf(item));
    let child = known.get(key);
    known.delete(key);
    if (!child) {
      child = make(item);
      child.dataset.key = key;
    }
    if (child === place) place = place.nextElementSibling;
    else parent.insertBefore(child, place);
    update(child, item);
  }
  for (const child of known.values()) child.remove();
}

/** A table of rows by key, sorted by the column whose head was pressed. */
export class Table {
  /**
   * `columns`: [{ name, title, value(row), words(row), link(row)?, number?, more? }]; rows are sorted by
   * `value`. `more` is { make(), update(node, row) } of what stands in a cell beside its words. With
   * `onsort(name, down)` rows come in their order, and it is called when a head was pressed.
   */
  constructor(root, columns, { caption, key, sorted = null, onsort = null }) {
    this.columns = columns;
    this.key = key;
    this.by = sorted;
    this.onsort = onsort;
    this.down = false;
    this.rows = [];
    this.body = element("tbody");
    this.heads = columns.map((column) => this.#head(column));
    root.replaceChildren(
      element("caption", { class: "unseen" }, caption),
      element("thead", {}, element("tr", {}, ...this.heads)),
      this.body,
    );
    this.#mark();
  }

  show(rows, state = () => "") {
    this.rows = rows;
    this.state = state;
    updateChildren(this.body, this.#sorted(), this.key, () => this.#row(), (node, row) => this.#fill(node, row));
  }

  #head(column) {
    const button = element("button", { type: "button" }, column.title);
    button.addEventListener("click", () => this.#sort(column.name));
    return element("th", { scope: "col", class: column.number ? "number" : null, "data-name": column.name }, button);
  }

  #sort(name) {
    this.down = this.by === name ? !this.down : this.columns.find((each) => each.name === name).number;
    this.by = name;
    this.#mark();
    if (this.onsort) this.onsort(this.by, this.down);
    else this.show(this.rows, this.state);
  }

  #mark() {
    for (const head of this.heads) {
      setAttribute(head, "aria-sort", head.dataset.name !== this.by ? null : this.down ? "descending" : "ascending");
    }
  }

  #sorted() {
    const column = this.columns.find(({ name }) => name === this.by);
    if (!column || this.onsort) return this.rows;
    const order = (a, b) => {
      const [one, other] = [column.value(a), column.value(b)];
      return typeof one === "string" ? one.localeCompare(other, "en", { numeric: true }) : one - other;
    };
    return this.rows.toSorted((a, b) => (this.down ? order(b, a) : order(a, b)));
  }

  #row() {
    return element(
      "tr",
      {},
      ...this.columns.map(({ name, number, link, more }, place) => {
        const shown = { class: number ? "number" : null, "data-name": name, scope: place ? null : "row" };
        const cell = element(place ? "td" : "th", shown);
        if (link) cell.append(element("a"));
        if (more) cell.append(more.make());
        return cell;
      }),
    );
  }

  #fill(node, row) {
    setAttribute(node, "data-state", this.state(row));
    this.columns.forEach(({ words, link, more }, place) => {
      const cell = node.children[place];
      if (link) setAttribute(cell.firstChild, "href", link(row));
      setText(link ? cell.firstChild : cell, words(row));
      if (more) more.update(cell.lastChild, row);
    });
  }
}

// The link past the lists to the main part, for those who use the keyboard.
document.getElementById("skip")?.addEventListener("click", (event) => {
  event.preventDefault(); // the address holds the selection
  document.getElementById("main").focus();
});
