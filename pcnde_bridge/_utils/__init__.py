"""Helpers that do not depend on blood flow: files, validation, parallel tasks, progress.

Every other subpackage may use them; they depend only on :mod:`pcnde_bridge.errors`.
"""
