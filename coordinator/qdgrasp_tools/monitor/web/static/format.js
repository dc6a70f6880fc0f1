// Numbers, times and sizes as a person reads them.

const THIN = "\u202f";
const counts = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });
const clock = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false });

export function count(number) {
  return counts.format(number).replaceAll(",", THIN);
}

/** A figure in a narrow place: 1234 -> "1 234", 1234567 -> "1.23 M". */
export function short(number) {
  if (Math.abs(number) < 1e5) return count(number);
  return number < 1e6 ? `${(number / 1e3).toFixed(0)}${THIN}k` : `${(number / 1e6).toPrecision(3)}${THIN}M`;
}

export function rate(number) {
  return number >= 100 ? count(number) : number.toFixed(1);
}

export function percent(part, whole) {
  if (!whole) return `0${THIN}%`;
  const share = (100 * part) / whole;
  const digits = part && share < 0.1 ? 2 : share < 10 ? 1 : 0;
  return `${share.toFixed(digits)}${THIN}%`;
}

/** Seconds as 0:03:20, or 2 d 4:00:00. */
export function span(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  const two = (part) => String(part).padStart(2, "0");
  const days = Math.floor(whole / 86400);
  const words = `${Math.floor(whole / 3600) % 24}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
  return days ? `${days}${THIN}d ${words}` : words;
}

/** Seconds since something was seen. */
export function ago(seconds) {
  if (seconds < 1.5) return "now";
  return seconds < 120 ? `${Math.round(seconds)}${THIN}s ago` : `${span(seconds)} ago`;
}

export function bytes(number) {
  if (!number) return "–";
  const mebi = number / 2 ** 20;
  return mebi < 1000 ? `${mebi.toFixed(0)}${THIN}MiB` : `${(mebi / 1024).toFixed(1)}${THIN}GiB`;
}

export function time(date) {
  return clock.format(date);
}

export function several(number, one, many = `${one}s`) {
  return `${count(number)} ${number === 1 ? one : many}`;
}
