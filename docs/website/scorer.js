// Order of search results: pages before the API and shown files, whole names before parts of names.
var Scorer = {
  score: (result) => result[4] + (/^(api|files)\//.test(result[0]) ? 0 : 20),
  objNameMatch: 11,
  objPartialMatch: -10,
  objPrio: { 0: 5, 1: 0, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
