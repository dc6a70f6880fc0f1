"""Worlds of physics engines beside Bullet; each is imported when a scene names its engine."""
