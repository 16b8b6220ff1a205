
for (const table of document.querySelectorAll("table:has(thead)")) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  heads.forEach((head, k) => {
    head.tabIndex = 0;
    head.style.cursor = "pointer";
    const sort = () => {
      const down = head.ariaSort === "ascending" ? -1 : 1;
      heads.forEach((other) => (other.ariaSort = "none"));
      head.ariaSort = down === 1 ? "ascending" : "descending";
      const value = (row) => row.cells[k].textContent.trim();
      body.append(...[...body.rows].sort((a, b) => {
        const [x, y] = [value(a), value(b)], both = parseFloat(x) - parseFloat(y);
        return down * (Number.isNaN(both) ? x.localeCompare(y) : both);
      }));
    };
    head.addEventListener("click", sort);
    head.addEventListener("keydown", (event) => event.key === "Enter" && sort());
  });
}
