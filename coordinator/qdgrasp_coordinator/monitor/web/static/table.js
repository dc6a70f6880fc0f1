// A table: rows by key, sorted by the column that somebody chose.

import { element, keyed, put, say } from "./element.js";

export class Table {
  /**
   * `columns`: [{ name, title, value(row), words(row), link(row)?, number? }]: what is sorted by and what is read.
   */
  constructor(root, columns, { caption, key, sorted = null }) {
    this.columns = columns;
    this.key = key;
    this.by = sorted;
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
    keyed(this.body, this.#sorted(), this.key, () => this.#row(), (node, row) => this.#fill(node, row));
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
    this.show(this.rows, this.state);
  }

  #mark() {
    for (const head of this.heads) {
      put(head, "aria-sort", head.dataset.name !== this.by ? null : this.down ? "descending" : "ascending");
    }
  }

  #sorted() {
    const column = this.columns.find(({ name }) => name === this.by);
    if (!column) return this.rows;
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
      ...this.columns.map(({ name, number, link }, place) => {
        const shown = { class: number ? "number" : null, "data-name": name, scope: place ? null : "row" };
        const cell = element(place ? "td" : "th", shown);
        if (link) cell.append(element("a"));
        return cell;
      }),
    );
  }

  #fill(node, row) {
    put(node, "data-state", this.state(row));
    this.columns.forEach(({ words, link }, place) => {
      const cell = node.children[place];
      if (link) put(cell.firstChild, "href", link(row));
      say(link ? cell.firstChild : cell, words(row));
    });
  }
}
