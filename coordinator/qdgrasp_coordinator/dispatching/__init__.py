"""Which rows go to which worker, and what comes back; pure, with the time passed in."""
