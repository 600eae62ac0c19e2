"""Julia engine: the package PCNDECore, called through juliacall.

Importing :mod:`pcnde_bridge.engines.julia.engine` starts nothing; creating its engine does.
"""
