// Who follows a link from another site comes without the cookie at first; from here the browser sends it.
(async function () {
  "use strict";
  const place = document.getElementById("sign-in");
  try {
    const answer = await fetch("/ui/signed-in", { credentials: "same-origin" });
    if ((await answer.json()).signed_in) location.replace(place.dataset.next);
  } catch (error) {
    // The form works without this.
  }
})();
