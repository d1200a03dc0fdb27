"""What `counterlight build --report` shows a person: one page, its pictures, and the same figures as JSON.

spectra.py and impossible.py measure, advice.py says what they and tools.ways found, pictures.py and charts.py draw,
page.py lays out, report.py joins and writes.
May import player and tools.{transport,clusters,inverse,relighting,ways}. Read next: report.py.
"""
