"""The Julia engine: PCNDECore called through juliacall.

The class is :class:`pcnde_bridge.engines.julia.engine.JuliaEngine`; importing it starts nothing.
"""
