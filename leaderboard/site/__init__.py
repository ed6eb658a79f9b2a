"""The board as one page that needs nothing but itself: tables to sort and filter, charts, and a part for each entry.

`builder.site_page` makes its text; `index.html.jinja`, `page.css` and `page.js` say how it looks and what it does, with
what every page has (dynagen_bench/html.css, html.js).
"""
