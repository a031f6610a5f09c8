"""The package whose modules are the files that users write: an effect, a device, a strategy of their own.

Any process finds them by their names, so what one process pickles another one can read.
"""

import sys

from needle_rig.config.python_file import Files

sys.meta_path.append(Files())
