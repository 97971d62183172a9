"use strict";
// What every page has: elements, files to take along, and an order for paper.
function element(kind, into, properties = {}) {
  const made = Object.assign(document.createElement(kind), properties);
  into.append(made);
  return made;
}

/** Let the reader save what an address holds. */
function save(address, name) {
  const link = element("a", document.body, { href: address, download: name });
  link.click();
  link.remove();
}

// On paper all that is folded away, and questions with long answers, stand at the end.
const moved = [];
addEventListener("beforeprint", () => {
  const folded = [...document.querySelectorAll("main details:not(.parts), #words")]
    .filter(d => !d.parentElement.closest("details"));
  if (moved.length || !folded.length) return;
  const appendix = element("section", document.querySelector("main"), { id: "appendix" });
  element("h2", appendix, { textContent: "Appendix" });
  for (const block of folded) {
    const heads = /^H[23]$/, above = block.previousElementSibling, below = block.nextElementSibling;
    const alone = above && heads.test(above.tagName)
      && (!below || below === appendix || folded.includes(below) || heads.test(below.tagName));
    for (const one of alone ? [above, block] : [block]) {
      const place = document.createComment("");
      one.replaceWith(place);
      moved.push([place, one, one.open]);
      if (one.tagName === "DETAILS") one.open = true;
      appendix.append(one);
    }
  }
});
addEventListener("afterprint", () => {
  for (const [place, block, open] of moved.splice(0)) {
    place.replaceWith(block);
    if (open !== undefined) block.open = open;
  }
  document.getElementById("appendix")?.remove();
});
