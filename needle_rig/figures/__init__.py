"""Pictures and pages: the only room that knows matplotlib, which is in the extra `figures`."""

from needle_rig.extras import needed

needed("matplotlib", "a picture", "figures")
