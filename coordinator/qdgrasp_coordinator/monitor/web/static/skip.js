// The way past the list to what is chosen from it, for those who go by keys.

document.getElementById("skip").addEventListener("click", (event) => {
  event.preventDefault(); // the address says what is chosen
  document.getElementById("main").focus();
});
