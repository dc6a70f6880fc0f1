// The extent of a job or run: the counted evaluations that it will have at most.

export function extent({ evaluations, budget, remaining, finished }) {
  const left = remaining ?? (finished ? 0 : Math.max(0, budget - evaluations));
  return Math.max(1, evaluations + left);
}
