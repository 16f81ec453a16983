# r: compas_fab==2.0.1, compas_eve==2.4.0
"""Component "answer": what became of a trajectory. Put a Grasshopper trigger of 500 ms on it.

In:  twin (from "connect"), sent (from "send")
Out: ok (true: a plan is under review; false: refused; empty: no answer yet), plan_id, text (one sentence)
"""

ok, plan_id, text = None, "", "nothing sent"
if twin is not None and sent:  # noqa: F821
    answer = twin.answer(sent)  # noqa: F821
    text = twin.answer_text(sent)  # noqa: F821
    if answer is not None:
        ok, plan_id = answer["ok"], answer["plan_id"]
