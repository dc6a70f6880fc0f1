"""Setup of hands that users bring: guessed gripper files, checks, and mended copies."""
