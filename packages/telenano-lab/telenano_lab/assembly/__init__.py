"""Particles: their places on a sample, motion under a tip, detection in images, and assembly by pushes.

The names below are public for other packages:

    from telenano_lab.assembly import Push, bench, carried_out, new_hand
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from telenano_lab.assembly.particle_bench import bench as bench
    from telenano_lab.assembly.particles.adhered_sphere import KINDS as KINDS
    from telenano_lab.assembly.particles.adhered_sphere import hold_of as hold_of
    from telenano_lab.assembly.particles.push import X as X
    from telenano_lab.assembly.particles.push import Y as Y
    from telenano_lab.assembly.particles.push import packed as packed
    from telenano_lab.assembly.particles.push import push_step as push_step
    from telenano_lab.assembly.particles.settings import ParticlesConfig as ParticlesConfig
    from telenano_lab.assembly.particles.steering import steered as steered
    from telenano_lab.assembly.particles.tip_shape import Spring as Spring
    from telenano_lab.assembly.particles.tip_shape import TipShape as TipShape
    from telenano_lab.assembly.particles.tip_shape import tip_shape as tip_shape
    from telenano_lab.assembly.particles.tip_shape import touch_distance_m as touch_distance_m
    from telenano_lab.assembly.push_hand import Hand as Hand
    from telenano_lab.assembly.push_hand import Push as Push
    from telenano_lab.assembly.push_hand import carried_out as carried_out
    from telenano_lab.assembly.push_hand import hand_moves as hand_moves
    from telenano_lab.assembly.push_hand import new_hand as new_hand
    from telenano_lab.assembly.push_hand import push_of as push_of
else:
    _MODULES = {
        "bench": "particle_bench",
        "KINDS": "particles.adhered_sphere",
        "hold_of": "particles.adhered_sphere",
        "X": "particles.push",
        "Y": "particles.push",
        "packed": "particles.push",
        "push_step": "particles.push",
        "ParticlesConfig": "particles.settings",
        "steered": "particles.steering",
        "Spring": "particles.tip_shape",
        "TipShape": "particles.tip_shape",
        "tip_shape": "particles.tip_shape",
        "touch_distance_m": "particles.tip_shape",
        "Hand": "push_hand",
        "Push": "push_hand",
        "carried_out": "push_hand",
        "hand_moves": "push_hand",
        "new_hand": "push_hand",
        "push_of": "push_hand",
    }

    def __getattr__(name: str) -> Any:
        # The steps of a push need the compiler; the layer and the program do without it.
        from importlib import import_module

        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
