"""Setup of hands that users bring: guessed gripper files, checks, and repaired copies."""
