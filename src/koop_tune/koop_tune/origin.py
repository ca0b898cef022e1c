"""Settings and what chose them."""

from __future__ import annotations

import functools

from koop_core.config.parameter import parameter

# chosen so that random rigs, commissioned offline, are damped most often
studied = functools.partial(parameter, origin="koop study commission")
# chosen for a rig whose oscillation begins all at once
jsbsim = functools.partial(parameter, origin="JSBSim's aircraft")
