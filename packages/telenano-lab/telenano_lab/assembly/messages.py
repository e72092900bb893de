"""The topic `afm/particles` with the true places of simulated particles (`telenano.topics`)."""

from typing import Annotated

from telenano.wire import Array, Lengths, Message, Topic, about


class AfmParticles(Message):
    """True places of the particles of a simulated instrument: no instrument knows them, and no planner may read them.

    They serve the judgement of a session afterwards; sent 20 times a second while a particle moves, else once a second.
    """

    simulated: Annotated[
        bool,
        about(
            "Always true: this is the truth of a simulation, not a measurement",
            extra_json_schema={"const": True, "examples": [True]},
        ),
    ]
    places_m: Annotated[Lengths, about("Centres on the sample, 0, 0 its middle, shape (n, 2) [m]")]
    radii_m: Annotated[Lengths, about("Radii, shape (n,) [m]")]
    moving: Annotated[Array, about("1 for a particle that has moved within its time of rest, else 0, shape (n,)")]

    def __post_init__(self) -> None:
        """Raise ValueError unless `simulated` is true."""
        if self.simulated is not True:
            raise ValueError("simulated must be true: no instrument knows where particles are")


# No node reads this topic, and no link carries it.
AFM_PARTICLES = Topic("afm/particles", AfmParticles, ("afm_node",), "lossless", None, None, None)
