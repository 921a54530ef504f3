"""What people read: words, tables, plots and the HTML report."""
