"""The ``physics`` preset: flow, area and pressure from closures that obey what the data obey.

As in the paper, the flow follows from the inlet waveform along the vessel, the area from
continuity, and the pressure from both; but each right-hand side is physics with few
numbers to learn, and all are coupled at every instant of a periodic cycle:

    ∂Q/∂z = −κ·(1 − g)·∂S/∂t          g learned: what the averaged flow hides
    S     = π·(r_u + u_r[p − p₀])²    u_r linear in p: clamped membrane, or tube law
    p     = p_d + 𝒵 Q(L) + losses[Q]  outlet; friction, inertia, jets behind narrowings

What belongs to one of them (``outlet``, ``losses``, ``wall``, ``correction``) is fitted to
the 3D cases with the others' true values, in this order; the correction last, with all
coupled.  The equations and their derivations are in
:mod:`pcnde_bridge.engines.jax.closures`, one file each, and under the same names in the Julia
core's ``closures``; :mod:`.fit` fits them, :mod:`.training` runs the fits,
:mod:`.uncertainty` says how far a prediction may be off.
"""
