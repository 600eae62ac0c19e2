"""Helpers that know nothing about blood flow.

Every other room may use them; they use only :mod:`pcnde_bridge.errors`.
"""
