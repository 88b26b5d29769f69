"""Contract tests for what users write: follower, operator, arbitration policy, cost and filter of grasps.

Each contract is a class of tests. Subclass it in a test module and override its one ``make_...`` method: pytest then
collects the whole suite. Without pytest, `Contract.check` runs it. See ``docs/testing-your-parts.md``.
"""

import sys

import lazy_loader

# pytest explains a failed assert only in modules that are registered before they are imported.
if pytest := sys.modules.get("pytest"):
    pytest.register_assert_rewrite(
        *(f"{__name__}.{module}" for module in ("contract", "costs", "followers", "loop", "operators", "policies"))
    )

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
