"""Certificates, access lists, and the proof that they hold (docs/security.md)."""
