"""Settings of the site that `make docs` builds: the pages of docs/, and references from the program.

Sphinx reads this file. The pages are plain Markdown that a code host shows too; what only the site has (navigation,
pages that the program writes) is made here and in the modules beside this one.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import neurotact

project = "neurotact"
author = "The neurotact authors"
project_copyright = author
version = release = neurotact.__version__

extensions = [
    "myst_parser", "sphinx.ext.autodoc", "sphinx_gallery.gen_gallery", "sphinx_copybutton",
    "docstrings", "mathml", "local", "written", "reachable", "notebooks",
]  # fmt: skip
root_doc = "index"
exclude_patterns = ["site", "examples", "sg_execution_times.rst", "**/sg_execution_times.rst"]

# An option keeps its two hyphens, also in the help of a command.
smartquotes_action = "qe"

# Anchors and math as code hosts understand them.
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]
myst_dmath_allow_digits = False

autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
maximum_signature_line_length = 100
toc_object_entries_show_parents = "hide"

# Every script of docs/examples runs when the site is built; one that fails ends the build.
sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery_of_examples",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "remove_config_comments": True,
    "write_computation_times": False,
    "thumbnail_size": (320, 220),
    "image_scrapers": ("matplotlib", "returned_figures"),
    "reset_modules": ("matplotlib",),
    "default_thumb_file": None,
}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

html_static_path = ["static"]
html_css_files = ["site.css"]
html_theme = "furo"
html_title = "neurotact"
html_copy_source = False
html_show_sourcelink = False
