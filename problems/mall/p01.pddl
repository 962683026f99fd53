; Two visitors, and shops that both may ask for. Which of them is asked for, goals say.

(define (problem mall-p01)
  (:domain mall)
  (:objects
    ann bob - visitor
    shop_0 shop_1 shop_2 shop_3 - shop)
  (:init)
  (:goal (understood ann shop_0)))
