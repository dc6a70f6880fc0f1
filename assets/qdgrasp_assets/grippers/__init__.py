"""The built-in grippers, one TOML each; the URDFs of the reference hands `ref_*` lie on the asset path."""
