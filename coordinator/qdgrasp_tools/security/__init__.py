"""Certificates, access lists, and the check that they hold (docs/security.md)."""
