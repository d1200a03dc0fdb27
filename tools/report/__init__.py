"""The report of `counterlight build --report`: one page, its pictures, and the same figures as JSON.

spectra.py and impossible.py measure. advice.py explains their findings and the findings of tools.ways. pictures.py and
charts.py draw, page.py and layout.py lay out, report.py joins and writes. acquired.py reports on acquisitions.

May import player and tools.{transport,clusters,inverse,relighting,ways}. Read next: report.py.
"""
