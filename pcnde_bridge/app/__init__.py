"""``pcnde app``: a local page to explore a fitted model.

``inputs`` and ``explorer`` compute what the page shows and need no browser, ``page`` is the
layout, ``callbacks`` its interaction, and ``server`` restricts access to this machine.
"""
