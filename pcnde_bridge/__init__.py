"""PCNDE (being built)."""
