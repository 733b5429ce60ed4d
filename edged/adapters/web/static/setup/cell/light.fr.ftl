# Texts of light.js.
light-title = Éclairage et netteté
light-what = Rendez les bords nets et ne laissez rien saturer : d’abord l’éclairage, puis les bagues des objectifs, en regardant ce que cela coûte.
light-thing = Posez d’abord une mire ou une pièce là où seront les pièces : éclairage et netteté se jugent sur elle, et une scène vide donnerait de mauvais conseils.
light-thing-is = Elle est là
light-thing-there = Éclairage et netteté sont jugés sur ce qui s’y trouve.
light-thing-gone = Il n’y a plus rien
light-take = Prenez la cellule pour régler temps d’exposition et gain : ses caméras sont nécessaires.
light-no-settings = Rien ne se règle ici : la caméra n’indique pas de limites, ou n’est pas là.
light-no-figures = Les chiffres viennent avec les images en direct.
settings-left = Réglages de la caméra gauche
settings-right = Réglages de la caméra droite
setting-exposure-us = Temps d’exposition
setting-gain-db = Gain
light-head = Éclairage
light-figures = { $clipped } % saturés, { $dark } % trop sombres, bruit { $noise } et contraste { $contrast } niveaux de gris
advice-good = L’exposition est bonne.
advice-less-light = Une partie est saturée, et ne peut être mesurée : moins d’exposition ou moins de lumière.
advice-more-light = Trop sombre : exposition plus longue, ou plus de lumière.
advice-light-for-gain = Bruité : moins de gain, et une exposition plus longue ou plus de lumière à la place.
advice-take = Régler { $exposure } µs
legend-clipped = saturé
legend-dark = trop sombre
light-copy = Mêmes réglages pour la caméra droite
focus-title = Netteté
focus-none = Pas de bords à juger : mettez-y une mire ou une pièce.
focus-now = Les bords ont { $now } px de large
focus-best = meilleur { $best } px
focus-cost =
    { $isFree ->
        [0] Cela ne coûte rien en sigma Z.
       *[other] Cela coûte +{ $percent } % en sigma Z.
    }
focus-reset = Oublier le meilleur
