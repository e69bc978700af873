"""The report of one reconstruction: a single HTML file that opens from disk, offline, for a person who must judge it.

``writer`` puts the page together from sections; a section holds panels, and a panel names the template that draws it.
Pages other than a session's own report can be made from the same parts with :func:`recon.report.page.render_page`.
"""
