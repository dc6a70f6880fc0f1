"""The contract of qdgrasp: words, specs, messages and the bus they travel on."""
