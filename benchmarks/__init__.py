"""Every number that the documentation states, measured again by one command: ``python -m benchmarks``.

One module per concern. Each gives ``measure(context)``, which returns plain numbers that are kept as JSON in
``bench-output/``, and ``render(values)``, which turns them into tables. ``page`` puts the tables together in
``docs/benchmarks.md``, where sections that are not measured again stay as they are; ``targets`` holds what the numbers
are compared with.
"""
