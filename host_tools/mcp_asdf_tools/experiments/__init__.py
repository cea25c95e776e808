"""Many trials without a bus: parameters, engine, results, scores and plots.

The results of a trial pass through these modules:

- ``sweep`` cuts experiments into jobs, and ``trials.run_trials`` runs a job: in C (``engine.native.run``),
  whose arrays are in the firmware's units, or message by message. ``results.Trials`` has the results of
  either, as arrays in the paper's units.
- ``store.Store`` keeps them as rows of a table (``result_tables.trials_to_table``), which ``result_files``
  writes: into parts while the sweep goes on, and into one file in the end.
- ``result_files.stream_experiments`` reads rows as ``Trials`` again. ``Trials.measures`` computes the scores
  and other measures that pictures and tables show.
"""
