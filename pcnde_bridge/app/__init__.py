"""``pcnde app``: a local page to explore a fitted model.

What the page computes is in :mod:`pcnde_bridge.app.inputs` and
:mod:`pcnde_bridge.app.explorer`, which need no browser; how it looks and reacts in
``page`` and ``callbacks``; who may reach it in ``server``.
"""
