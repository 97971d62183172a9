// Asks again when something is typed or chosen, and shows what the same page says of it.
"use strict";

const form = document.getElementById("form");
let asked = 0, timer = 0;

function show(page) {
  document.getElementById("answer").replaceWith(page.getElementById("answer"));
  for (const field of page.querySelectorAll("[id^=field-]")) {
    document.getElementById(field.id).hidden = field.hidden;
  }
  const picture = document.getElementById("picture"), next = page.getElementById("picture");
  picture.alt = next.alt;
  picture.src = next.getAttribute("src"); // the old one stays until the new one is there
}

function fail() {
  const said = document.createElement("p");
  said.className = "bad";
  said.id = "error";
  said.textContent = "No answer: has the program that serves this page ended?";
  document.getElementById("error")?.remove();
  document.getElementById("answer").prepend(said);
}

async function ask() {
  const mine = ++asked, query = "?" + new URLSearchParams(new FormData(form));
  history.replaceState(null, "", query); // so that it is there after a reload
  try {
    const reply = await fetch(query);
    const page = new DOMParser().parseFromString(await reply.text(), "text/html");
    if (mine === asked) reply.ok ? show(page) : fail();
  } catch {
    if (mine === asked) fail();
  }
}

document.addEventListener("input", () => {
  clearTimeout(timer);
  timer = setTimeout(ask, 120);
});
form.addEventListener("submit", event => {
  event.preventDefault();
  ask();
});

// What was typed or chosen before this script was there.
function touched(field) {
  if (field instanceof HTMLSelectElement) {
    const first = [...field.options].findIndex(option => option.defaultSelected);
    return field.selectedIndex !== Math.max(first, 0);
  }
  // The value of a box without one is "on", and by default "".
  if (["checkbox", "radio"].includes(field.type)) return field.checked !== field.defaultChecked;
  return field instanceof HTMLInputElement && field.value !== field.defaultValue;
}
if ([...form.elements].some(touched)) ask();
