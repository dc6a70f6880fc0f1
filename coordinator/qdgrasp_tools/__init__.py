"""The commands, and campaigns, exports, reports, pictures, monitors and verification."""
