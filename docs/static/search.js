// Order of the results of a search: how-to pages, demos, other reference, API. A name of the API
// that was typed in full comes first if it is no plain word (solve_modes), and those of classes and
// functions (Structure) after titles.
var Scorer = {
  score: ([page, title, , kind, score, , found]) => {
    if (page.startsWith("api/")) {
      if (found !== "object" || score < 16) return score / 20;
      if (/_|[a-z][A-Z]/.test(title.split(".").pop())) return 26;
      return /^Python (class|function)/.test(kind) ? 10 : score / 20;
    }
    const later = /^(benchmarks|blind|case-file|changelog|contributing|json|peers|thresholds)/;
    return later.test(page) ? score / 4 : page.includes("/") ? score - 1 : score;
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
