"""Helpers that know nothing about blood flow: files, validation, parallel tasks, progress.

Every other room may use them; they depend only on :mod:`pcnde_bridge.errors`.
"""
